"""The `ActorGenerator` seam: from one observation to a vehicle seen from all sides."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field
from typing import Protocol, runtime_checkable

from recast.actors.axes import AxisConvention
from recast.actors.observation import Observation
from recast.parts import GENERATORS
from recast.splats import CLASSIC, Gaussians, LowPass

DEFAULT_GENERATOR = "auto"


@dataclass(frozen=True)
class Asset:
    """A generated vehicle before registration.

    Attributes:
        gaussians: in the generator's own frame and units.
        axes: what that frame is.
        generator: name, for the record.
        seed: that made it.
        details: facts about how it was made, plain values.
        low_pass: filter that the Gaussians were made for.
    """

    gaussians: Gaussians
    axes: AxisConvention
    generator: str
    seed: int
    details: Mapping[str, str | float | int] = field(default_factory=dict)
    low_pass: LowPass = CLASSIC


class ActorGenerator(Protocol):
    """Makes a view-complete vehicle from one view of it."""

    name: str

    def generate(self, observation: Observation, seed: int) -> Asset:
        """The vehicle; the same observation and seed give the same asset."""


@runtime_checkable
class OffersCandidates(Protocol):
    """A generator that knows several vehicles which the view may show."""

    def candidates(self, observation: Observation, seed: int) -> Sequence[Callable[[], Asset]]:
        """What makes each of them, the likeliest first; each may raise InputError."""


def candidates_of(
    generator: ActorGenerator, observation: Observation, seed: int
) -> Sequence[Callable[[], Asset]]:
    """What makes each vehicle that a generator offers: all it has, or the one."""
    if isinstance(generator, OffersCandidates):
        return generator.candidates(observation, seed)
    return [lambda: generator.generate(observation, seed)]


def make_generator(name: str) -> ActorGenerator:
    """Make the generator of that name.

    Raises:
        InputError: there is no such generator.
    """
    generator: ActorGenerator = GENERATORS.load(name)()
    return generator
