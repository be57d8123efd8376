"""The `ActorGenerator` seam, from an observation to a vehicle, and which way up that vehicle lies.

Three things are true of cars, vans, trucks and buses: they are as wide and as high for their length
as the logged box; left mirrors right, but the top does not mirror the bottom; and they stand on
wheels, so that little of them touches the ground, while much of the roof lies near its highest
point and is smaller than the floor. Of the six axes, the one for which these speak most is up.
"""

from __future__ import annotations

from abc import abstractmethod
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field, replace
from functools import partial
from pathlib import Path
from typing import Protocol

import numpy as np
from numpy.typing import ArrayLike
from scipy.spatial import cKDTree

from recast.actors.icp import bounds, extent
from recast.actors.observation import Observation
from recast.arrays import Array
from recast.core.errors import InputError
from recast.core.foreign import BasePart, foreign_call, read_only, whole
from recast.core.plugins import GENERATORS
from recast.scene.deformation import Gait
from recast.splats import CLASSIC, Gaussians, LowPass
from recast.trellis import (
    RECAST_MINI,
    GenerationLimits,
    ImageTo3D,
    MultiImageMode,
    generate,
    recast_mini,
)

LARGEST_MISFIT = 1.6
"""Largest factor between width or height (for the length) and the box's."""
LEAST_EVIDENCE = 2.0
"""Units of evidence that the best axis must have, and by which it must be ahead of the next."""
MOST_AGAINST = 0.5
"""Units by which one kind of evidence may speak against the best axis."""

_POINTS = 6000
_EVERY = 4  # point counts where many yaws are tried, and where points are mirrored
_YAWS = np.radians(np.arange(0.0, 90.0, 2.0))
_FINER = np.radians(np.arange(-1.75, 2.0, 0.25))
_CELLS = 48  # of the maps from above and from below, along the length
_CONTACT = 0.06  # share of the height: tyres reach further down than floors do by more than that
_LOWER, _UPPER = (0.1, 0.4), (0.6, 0.9)  # shares of the height that are compared in extent
_LIMIT = 4.0  # units that one kind of evidence is worth at most; the box is not limited
# What counts as one unit: log of width and height, mirrored distance over length, logs of areas.
_BOX, _SYMMETRY, _WHEELS, _TAPER = 0.10, 0.006, 0.4, 0.2


@dataclass(frozen=True)
class AxisConvention:
    """How an asset's frame relates to the actor frame (x forward, y left, z up).

    Attributes:
        name: name of the convention, for messages.
        forward, up: signed axes of the asset, such as "+x" or "-z". The yaw search of the
            registration corrects a wrong `forward`, but not a wrong `up`.
        declares_front: whether `forward` is known to be the vehicle's, not only an axis of the
            file. Lengths are never relied upon: assets are scaled to the logged box.
    """

    name: str
    forward: str
    up: str
    declares_front: bool

    def rotation(self) -> Array:
        """(3, 3) actor axes from asset axes, a proper rotation. Raises ValueError: an axis is not
        one of +x -x +y -y +z -z, or both are the same axis."""
        forward, up = _axis(self.forward), _axis(self.up)
        if abs(float(forward @ up)) > 0.5:
            raise ValueError(
                f"AxisConvention: forward {self.forward} and up {self.up} are parallel"
            )
        return np.stack([forward, np.cross(up, forward), up])


def _axis(name: str) -> Array:
    if len(name) != 2 or name[0] not in "+-" or name[1] not in "xyz":
        raise ValueError(
            f"AxisConvention: {name!r} is not an axis (a sign and a letter, such as +x)"
        )
    axis = np.zeros(3)
    axis["xyz".index(name[1])] = 1.0 if name[0] == "+" else -1.0
    return axis


VEHICLE = AxisConvention("vehicle", "+x", "+z", declares_front=True)
"""Metres, x forward, z up: what `template` makes."""
UNIT_CUBE_Z_UP = AxisConvention("unit_cube_z_up", "+x", "+z", declares_front=False)
"""A cube of edge one, z up, any heading: TRELLIS and its relatives."""
UNIT_CUBE_X_FORWARD = AxisConvention("unit_cube_x_forward", "+x", "+z", declares_front=True)
"""A cube of edge one, z up, facing +x: models that were trained on vehicles that all do."""
UNIT_CUBE_Y_UP = AxisConvention("unit_cube_y_up", "+z", "+y", declares_front=False)
"""A cube of edge one, y up, facing +z: glTF and most mesh tools."""
RECAR_BOX = AxisConvention("rear_right_up", "-x", "+z", declares_front=True)
"""Metres, x to the rear, y to the right: boxes of some vehicle datasets."""

CONVENTIONS = {
    c.name: c for c in (VEHICLE, UNIT_CUBE_Z_UP, UNIT_CUBE_X_FORWARD, UNIT_CUBE_Y_UP, RECAR_BOX)
}

UPS = {
    up: AxisConvention(
        up.replace("-", "minus-").removeprefix("+") + "-up", "+y" if "x" in up else "+x", up, False
    )
    for up in ("+x", "-x", "+y", "-y", "+z", "-z")
}
"""Conventions of any unit and heading, by the axis that points up."""

AUTO = "auto"
"""Name that stands for telling the axes from the shape, see `recast.actors.generate`."""
AXES_HELP = (
    "auto, an up axis such as z-up, y-up or minus-y-up, or FORWARD,UP such as x,z (or --axes=-y,z)"
)


def axes_of(text: str) -> AxisConvention:
    """The convention of a name, of `UPS` or `CONVENTIONS`, or of two signed axes, such as "x,-y".

    Raises:
        InputError: there is none.
    """
    named = {one.name: one for one in UPS.values()} | CONVENTIONS
    if text in named:
        return named[text]
    axes = [axis if axis[:1] in "+-" else f"+{axis}" for axis in text.split(",")]
    try:
        forward, up = axes
        convention = AxisConvention(text, forward, up, declares_front=True)
        convention.rotation()
    except ValueError:
        raise InputError(
            "`axes`",
            text,
            "is not an axis convention",
            f"give {AXES_HELP}; or one of {', '.join(CONVENTIONS)}",
        ) from None
    return convention


@dataclass(frozen=True)
class Posture:
    """How a vehicle would stand with one of its axes up."""

    up: str  # signed axis, such as "-y"
    # width_over_box, height_over_box: width and height for its length, over those of the box.
    width_over_box: float
    height_over_box: float
    votes: dict[str, float]  # evidence for it, in units: box (0 at best), symmetry, wheels, taper

    @property
    def total(self) -> float:
        """Sum of the votes."""
        return sum(self.votes.values())

    @property
    def fits(self) -> bool:
        """Whether width and height are those of the box, roughly."""
        ratios = np.array([self.width_over_box, self.height_over_box])
        return bool(np.all(np.abs(np.log(ratios)) <= np.log(LARGEST_MISFIT)))

    @property
    def convincing(self) -> bool:
        """Whether the shape, too, speaks for it."""
        against = min(vote for kind, vote in self.votes.items() if kind != "box")
        return self.total >= LEAST_EVIDENCE and against >= -MOST_AGAINST

    @property
    def axes(self) -> AxisConvention:
        """The convention; which way it faces is not known."""
        return UPS[self.up]

    def explain(self) -> str:
        """One line with the evidence."""
        votes = ", ".join(f"{kind} {vote:+.1f}" for kind, vote in self.votes.items())
        return (
            f"{self.axes.name}: {self.width_over_box:.2f} of the box's width and "
            f"{self.height_over_box:.2f} of its height, {votes}"
        )


def postures(points: Array, size: ArrayLike) -> list[Posture]:
    """All six postures, the most likely first.

    Args:
        points: (N, 3) points of an outer surface (`outer_surface`), in any unit; lying by quarters
            of a turn, and turned about the vertical by any angle.
        size: (3,) length, width, height of the box that the vehicle stands for.
    """
    points = np.asarray(points, np.float64)[:: max(1, len(points) // _POINTS)]
    found = [one for axis in range(3) for one in _about(points, axis, np.asarray(size, np.float64))]
    return sorted(found, key=lambda posture: -posture.total)


def upright(points: Array, size: ArrayLike, path: Path) -> Posture:
    """The posture that the shape tells, of a vehicle from a file.

    Args:
        points, size: see `postures`.
        path: the file, for messages.

    Raises:
        InputError: no orientation fits the box, or the shape does not tell it.
    """
    mend = f"give `axes`: {AXES_HELP}"
    best, second, *_ = found = postures(points, size)
    if not best.fits:
        box = " x ".join(f"{metres:.2f}" for metres in np.asarray(size))
        closest = max(found, key=lambda one: one.votes["box"])
        raise InputError(
            path,
            "axes",
            f"no orientation fits a box of {box} m: {closest.axes.name}, the closest, has "
            f"{closest.width_over_box:.2f} of its width and {closest.height_over_box:.2f} of "
            "its height",
            mend,
        )
    if not best.convincing or best.total - second.total < LEAST_EVIDENCE:
        raise InputError(
            path,
            "axes",
            f"the shape does not show which way is up: {best.explain()}; "
            f"second best is {second.axes.name}",
            mend,
        )
    return best


def _about(points: Array, axis: int, size: Array) -> list[Posture]:
    """The postures with one axis up, and with it down."""
    flat = _lengthwise(np.delete(points, axis, axis=1))
    upright = np.column_stack([flat, points[:, axis]])
    length, width, height = extent(upright)
    ratios = (width / length * size[0] / size[1], height / length * size[0] / size[2])
    shared = {
        "box": -float(np.abs(np.log(ratios)).sum()) / _BOX,
        "symmetry": _vote(_asymmetry(upright, 2) - _asymmetry(upright, 1), length * _SYMMETRY),
    }
    wheels = _vote(np.log(_contact(upright * [1, 1, -1]) / _contact(upright)), _WHEELS)
    taper = _vote(np.log(_extent(upright, _LOWER) / _extent(upright, _UPPER)), _TAPER)
    return [
        Posture(
            f"{sign}{'xyz'[axis]}",
            float(ratios[0]),
            float(ratios[1]),
            shared | {"wheels": way * wheels, "taper": way * taper},
        )
        for sign, way in (("+", 1), ("-", -1))
    ]


def _vote(difference: float, unit: float) -> float:
    return float(np.clip(difference / unit, -_LIMIT, _LIMIT))


def lengthwise_yaw(flat: Array) -> float:
    """Radians that turn points (N, 2) to lie lengthwise along x, either way round."""
    yaw, across = _smallest_rectangle(flat)
    return -yaw + (np.pi / 2 if across else 0.0)


def _lengthwise(flat: Array) -> Array:
    """Points (N, 2) turned so that the rectangle around them is smallest, its length first."""
    yaw, across = _smallest_rectangle(flat)
    turned = _turned_back(flat, yaw)
    return turned[:, ::-1] if across else turned


def _smallest_rectangle(flat: Array) -> tuple[float, bool]:
    """Yaw of the smallest rectangle around points (N, 2), and whether it is longer across."""
    few = flat[::_EVERY]

    def area(yaw: float) -> float:
        return float(np.prod(extent(_turned_back(few, yaw))))

    best = float(min(min(_YAWS, key=area) + _FINER, key=area))
    length, width = extent(_turned_back(flat, best))
    return best, bool(length < width)


def _turned_back(points: Array, yaw: float) -> Array:
    sine, cosine = np.sin(yaw), np.cos(yaw)
    return points @ np.array([[cosine, -sine], [sine, cosine]])


def _asymmetry(points: Array, axis: int) -> float:
    """Mean distance from the points (N, 3), mirrored along an axis, to the nearest one."""
    low, high = bounds(points)
    mirrored = points.copy()
    mirrored[:, axis] = low[axis] + high[axis] - mirrored[:, axis]
    distance, _ = cKDTree(points).query(mirrored[::_EVERY])
    return float(distance.mean())


def _contact(points: Array) -> float:
    """Share of the footprint of points (N, 3) that reaches down to the ground, nearly."""
    low, high = bounds(points)
    cells = np.floor(points[:, :2] / ((high - low)[0] / _CELLS)).astype(np.int64)
    _, cell = np.unique(cells, axis=0, return_inverse=True)
    lowest = np.full(cell.max() + 1, np.inf)
    np.minimum.at(lowest, cell.ravel(), points[:, 2])
    reached = int((lowest < low[2] + _CONTACT * (high - low)[2]).sum())
    return (reached + 1) / len(lowest)  # never none


def _extent(points: Array, band: Sequence[float]) -> float:
    """Area of the rectangle around the points (N, 3) between two shares of the height."""
    low, high = bounds(points)
    height = (points[:, 2] - low[2]) / (high - low)[2]
    inside = points[(height >= band[0]) & (height <= band[1]), :2]
    if len(inside) < 2:
        return float(np.prod((high - low)[:2]))
    sides = extent(inside, share=0.02)
    return float(np.prod(np.maximum(sides, 1e-3 * (high - low)[0])))


DEFAULT_GENERATOR = "auto"
PEOPLE_GENERATOR = "people"
"""Name of the generator whose actors all have a gait."""
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
        finish: makes the asset itself where this is a sketch of it, coarse but of the same shape
            and colours, to be compared with other candidates; None if this is the asset.
        gait: gait of a person, in metres in the frame of the box, on no way yet, with the phase
            of the image that it was made from; None for a vehicle.
    """

    gaussians: Gaussians
    axes: AxisConvention
    generator: str
    seed: int
    details: Mapping[str, str | float | int] = field(default_factory=dict)
    low_pass: LowPass = CLASSIC
    finish: Callable[[], Asset] | None = None
    gait: Gait | None = None


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
        each may raise InputError, and may give a sketch (`Asset.finish`). The one of `generate`
        unless a generator knows several."""
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
