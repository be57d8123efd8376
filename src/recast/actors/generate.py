"""The `ActorGenerator` seam, from an observation to a vehicle seen from all sides."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field
from pathlib import Path
from typing import Protocol, runtime_checkable

from recast.actors.axes import AUTO, AxisConvention
from recast.actors.observation import Observation
from recast.core.errors import InputError
from recast.core.parts import GENERATORS
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


def make_generator(generator: str | Path | ActorGenerator, axes: str = AUTO) -> ActorGenerator:
    """Make a generator, or return the one given.

    Args:
        generator: one of `GENERATORS.names()`; a PLY, GLB or OBJ file; "library:FOLDER"; the folder
            of an image-to-3D model; "package.module:attribute"; or an `ActorGenerator`. See
            `recast.core.plugins.Registry.resolve`.
        axes: orientation of files or a model, see `recast.actors.axes_of`. With "auto", that of a
            file is told from its shape, and models are z up with any heading.

    Raises:
        InputError: no such generator, no such file, no such axes, or axes of a generator that knows
            its own; or a model that cannot be loaded.
    """
    options = {} if axes == AUTO else {"axes": axes}
    if options and not GENERATORS.takes(generator, "axes"):
        raise InputError(
            "--axes",
            axes,
            f"is not for the generator {generator}, which knows its axes",
            "leave it out",
        )
    made: ActorGenerator = GENERATORS.resolve(generator, **options)
    return made
