"""The `ActorGenerator` seam, from an observation to a vehicle; and the paper's generator."""

from __future__ import annotations

from abc import abstractmethod
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field, replace
from functools import partial
from pathlib import Path
from typing import Protocol

from recast.actors.axes import AUTO, UNIT_CUBE_X_FORWARD, UNIT_CUBE_Z_UP, AxisConvention, axes_of
from recast.actors.observation import Observation
from recast.core.errors import InputError
from recast.core.foreign import BasePart, foreign_call, read_only, whole
from recast.core.plugins import GENERATORS
from recast.splats import CLASSIC, Gaussians, LowPass
from recast.trellis import (
    RECAST_MINI,
    GenerationLimits,
    ImageTo3D,
    MultiImageMode,
    generate,
    recast_mini,
)

DEFAULT_GENERATOR = "auto"
_WHOLE = 0.9  # of the box in the image: the model takes every picture for that of a whole vehicle
_MINI_SEEDS = 4  # of the small model, 1.6 s each


@dataclass(frozen=True)
class Asset:
    """A generated vehicle before registration.

    Attributes:
        gaussians: Gaussians in the generator's own frame and units.
        axes: axis convention of that frame.
        generator: name of the generator, for the record.
        seed: seed that the asset was made with.
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
    """Makes a view-complete vehicle from one view of it.

    These members are enough; `BaseGenerator` has all others, with their defaults.
    """

    name: str

    def generate(self, observation: Observation, seed: int) -> Asset:
        """The vehicle; the same observation and seed give the same asset."""


class BaseGenerator(BasePart):
    """An `ActorGenerator` with all members that are asked for: derive yours from it."""

    name: str

    @abstractmethod
    def generate(self, observation: Observation, seed: int) -> Asset:
        """The vehicle; the same observation and seed give the same asset."""

    def candidates(self, observation: Observation, seed: int) -> Sequence[Callable[[], Asset]]:
        """Functions that make each of the vehicles that the view may show, the likeliest first;
        each may raise InputError. The one of `generate` unless a generator knows several."""
        return [partial(generated, self, observation, seed)]


def candidates_of(
    generator: ActorGenerator, observation: Observation, seed: int
) -> Sequence[Callable[[], Asset]]:
    """What makes each vehicle that a generator, which may be a user's, offers; read-only input.
    Raises InputError: see `generated`."""
    offering = whole(generator, BaseGenerator)
    with foreign_call(f"generator {generator.name}", "candidates", offering, seed):
        return offering.candidates(read_only(observation), seed)


def generated(generator: ActorGenerator, observation: Observation, seed: int) -> Asset:
    """What a generator, which may be a user's, makes of a read-only observation. Raises InputError:
    a user's generator raises an exception; see also `foreign_call`."""
    with foreign_call(f"generator {generator.name}", "generate", generator, seed):
        return generator.generate(read_only(observation), seed)


def make_generator(generator: str | Path | ActorGenerator, axes: str = AUTO) -> BaseGenerator:
    """Make a generator, or return the one given, with all members that it lacks.

    Args:
        generator: one of `GENERATORS.names()`; a PLY, GLB, OBJ, SPZ or USDA file;
            "library:FOLDER"; the folder of an image-to-3D model; "package.module:attribute"; or
            an `ActorGenerator`.
        axes: orientation of files or a model, see `recast.actors.axes_of`. With "auto", that of a
            file is told from its shape, and models are z up with any heading.

    Raises:
        InputError: no such generator, no such file, no such axes, or axes of a generator that knows
            its own; or a model that cannot be loaded.
    """
    options = {} if axes == AUTO else {"axes": axes}
    if options and not GENERATORS.takes(generator, "axes"):
        raise InputError(
            "`axes`",
            axes,
            f"does not apply to the generator {generator}, whose axes are fixed",
            "leave `axes` out",
        )
    return whole(GENERATORS.resolve(generator, **options), BaseGenerator)


class ImageTo3DGenerator(BaseGenerator):
    """Generates the vehicle from its RGBA crop (RECAST, section 2, inference), or from several.

    Further views in which the vehicle is cut off are left out.

    Args:
        folder: model in the published layout, see `ImageTo3D.load`.
        image_encoder: weights of the published image encoder, where the folder has none.
        limits: what counts as a failed structure; three further seeds by default, since a whole
            run should not end because one of them failed.
        name: name of the generator, for the record.
        axes: axis convention of what the model makes; published models give any heading.
        offers: number of seeds that are offered to choose from.
        mode: how several views are used, see `recast.trellis.sampler.Condition`.

    Raises:
        InputError: see `ImageTo3D.load`.
    """

    def __init__(
        self,
        folder: str | Path,
        image_encoder: str | Path | None = None,
        limits: GenerationLimits | None = None,
        name: str = "image-to-3d",
        axes: AxisConvention = UNIT_CUBE_Z_UP,
        offers: int = 1,
        mode: MultiImageMode = "stochastic",
    ) -> None:
        self.name, self.axes, self.offers, self.mode = name, axes, offers, mode
        self.folder = Path(folder)
        self.model = ImageTo3D.load(self.folder, image_encoder=image_encoder)
        self.limits = limits or GenerationLimits(retries=3)

    def candidates(self, observation: Observation, seed: int) -> Sequence[Callable[[], Asset]]:
        """Vehicles of `seed` and further ones; see `BaseGenerator.candidates`.

        Of several views, every second seed gets the best one alone.
        """
        seen = observation, replace(observation, further=())
        step = self.limits.retries + 1  # the seeds between are for structures that fail
        return [partial(self.generate, seen[i % 2], seed + i * step) for i in range(self.offers)]

    def generate(self, observation: Observation, seed: int) -> Asset:
        """Generate from the crops.

        Raises:
            InputError: the mask is unusable, or the structure failed with every seed allowed.
        """
        whole = [one for one in observation.further if one.view.in_image >= _WHOLE]
        made = generate(
            self.model,
            [[observation.rgba, *(one.rgba for one in whole)]],
            [seed],
            names=[f"crop of track {observation.track_id}"],
            mode=self.mode,
            limits=self.limits,
        )
        vehicle = made.vehicles[0]
        return Asset(
            vehicle.gaussians,
            self.axes,
            self.name,
            vehicle.seed,
            {
                "model": self.folder.resolve().name,
                "voxels": len(vehicle.coords),
                "views": 1 + len(whole),
            },
            self.model.low_pass,
        )


def model_generator(folder: str | Path, axes: str = AUTO) -> ImageTo3DGenerator:
    """The generator of a model's folder.

    Args:
        folder: see `ImageTo3DGenerator`.
        axes: orientation of what the model makes, see `axes_of`; "auto" for z up with any heading.

    Raises:
        InputError: there are no such axes, or the model cannot be loaded.
    """
    return ImageTo3DGenerator(folder, axes=UNIT_CUBE_Z_UP if axes == AUTO else axes_of(axes))


def recast_mini_generator() -> ImageTo3DGenerator:
    """The small model that comes with the package."""
    return ImageTo3DGenerator(
        recast_mini(), name=RECAST_MINI, axes=UNIT_CUBE_X_FORWARD, offers=_MINI_SEEDS
    )
