"""The `ActorGenerator` seam: from one observation to a vehicle seen from all sides."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field
from typing import Protocol

from recast.actors.axes import AxisConvention
from recast.actors.observation import Observation
from recast.parts import GENERATORS
from recast.splats import CLASSIC, Gaussians, LowPass

DEFAULT_GENERATOR = "recast-mini"


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


def make_generator(name: str) -> ActorGenerator:
    """Make the generator of that name.

    Raises:
        InputError: there is no such generator.
    """
    generator: ActorGenerator = GENERATORS.load(name)()
    return generator
