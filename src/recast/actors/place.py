"""Where an asset stands at first, and its place in the box by pictures alone, without LiDAR.

At first: turned, scaled by the length, on the floor. Then yaw over the whole circle by silhouette
and colours against the conditioning views, front against back by votes, and a small refinement of
scale and place by the silhouette. With LiDAR, `register` does better.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass

import numpy as np
import torch
from numpy.typing import ArrayLike
from scipy.optimize import minimize

from recast.actors.actor import triple
from recast.actors.generate import Asset
from recast.actors.icp import Fit, FitSurface, belonging, bounds, extent, outer_surface
from recast.actors.insert import compare_views
from recast.actors.observation import Observation
from recast.arrays import Array
from recast.core.errors import InputError
from recast.geometry import se3
from recast.logs import Track
from recast.splats import Gaussians, LowPass

_LARGEST = 1e5  # extent at which everything must still be in range: no box asks for a larger one
COARSE_YAWS = np.arange(0, 2 * np.pi, np.radians(15.0))
FINE_YAWS = np.radians([-7.5, -5.0, -2.5, 0.0, 2.5, 5.0, 7.5])
"""Turns about the vertical that are tried: all around, then about the best of these, radians."""
# What counts as much as one unit of cost in the search: overlap, colour, log of width and height.
_UNITS = (0.03, 0.02, 0.10)
_DECLARED = 3.0  # units of evidence for the front that a convention declares
_SPREAD = np.array([0.05, 0.12, 0.10, 0.05])  # log scale; metres along, across, up
_OVERLAP_WEIGHT = 60.0  # as in the template's own placement: 1 % of overlap is worth 0.6
_EVALUATIONS = 120
# Differences that count as one unit of evidence, and the weight of the declared forward axis.
_LIDAR_UNIT, _SILHOUETTE_UNIT, _COLOUR_UNIT = 0.015, 0.03, 0.02
_AXES_WEIGHT = 1.5
_LIMIT = 4.0  # units that one kind of evidence is worth at most


@dataclass(frozen=True)
class PoseAgreement:
    """How a turned asset agrees with the observation."""

    lidar: Fit | None  # fit to the LiDAR points after a short alignment; None where there are none
    # intersection over union of its outline, seen from the crop's camera, and the mask.
    silhouette: float
    # mean absolute difference to the crop where both are, display values, after the best gain of
    # each channel.
    colour: float


def heading_agreement(track: Track) -> float:
    """Cosine between the track's heading and its motion, averaged over the way; 0 when it stands.

    Labels may be reversed: then the box's front is not the vehicle's.
    """
    positions = track.trajectory.poses[:, :2, 3]
    steps = np.diff(positions, axis=0)
    lengths = np.linalg.norm(steps, axis=1)
    if np.linalg.norm(positions[-1] - positions[0]) < 2.0:
        return 0.0
    headings = track.trajectory.poses[:-1, :2, 0]
    return float(np.sum(steps * headings) / max(float(lengths.sum()), 1e-9))


def front_votes(
    as_is: PoseAgreement, turned: PoseAgreement, declared: bool, heading: float
) -> dict[str, float]:
    """Evidence, in units, for the first of two orientations half a turn apart; each at most 4.

    Args:
        as_is, turned: agreement with the asset's forward axis along the box's, and the other way.
        declared: whether the asset's axis convention says where its front is.
        heading: agreement of heading and motion, from `heading_agreement`.
    """

    def vote(difference: float, unit: float) -> float:
        return float(np.clip(difference / unit, -_LIMIT, _LIMIT))

    # a box labelled back to front makes the declared front the wrong one; a standing vehicle's
    # label is believed a little
    direction = heading if heading != 0.0 else 0.5
    lidar = {}
    if as_is.lidar is not None and turned.lidar is not None:
        lidar["lidar"] = vote(turned.lidar.mean - as_is.lidar.mean, _LIDAR_UNIT)
    return lidar | {
        "silhouette": vote(as_is.silhouette - turned.silhouette, _SILHOUETTE_UNIT),
        "colour": vote(turned.colour - as_is.colour, _COLOUR_UNIT),
        "heading": _AXES_WEIGHT * direction if declared else 0.0,
    }


@dataclass(frozen=True)
class Start:
    """asset_placed = matrix (scale x), with the asset's axes turned upright already."""

    yaw: float  # turn about the vertical, radians
    scale: float  # metres per unit of the asset
    matrix: Array  # (4, 4) rigid part, applied after the scale

    def apply(self, surface: FitSurface) -> FitSurface:
        """The surface, placed."""
        points = se3.apply(self.matrix, surface.points * self.scale)
        return FitSurface(points, surface.normals @ self.matrix[:3, :3].T, surface.index)


def stood_up(asset: Asset) -> tuple[Gaussians, FitSurface]:
    """An asset without floaters, its axes turned upright, in its own units, and its outer surface.
    Raises InputError: it is hardly opaque, has no volume, or has values that are not finite or out
    of range, if only at the size of a box."""
    where, mend = f"asset of {asset.generator}", "use another seed, or export the asset again"
    fault = asset.gaussians.fault()
    if fault is not None:
        raise InputError(where, *fault, mend)
    turn = se3.from_rotation_translation(asset.axes.rotation(), np.zeros(3))
    gaussians = asset.gaussians.detach()
    kept = belonging(gaussians)
    if not kept.all():
        gaussians = gaussians.select(torch.from_numpy(kept))
    gaussians = gaussians.transformed(torch.from_numpy(turn))
    try:
        surface = outer_surface(gaussians)
    except ValueError as error:
        raise InputError(where, "shape", str(error), mend) from None
    extent = float(np.ptp(surface.points, axis=0).max())
    fault = gaussians.transformed(torch.eye(4), _LARGEST / extent).fault()
    if fault is not None:
        problem = f"at the size of a box, {fault[1]} (it extends over {extent:.3g} units)"
        raise InputError(where, fault[0], problem, mend)
    return gaussians, surface


def stand_on_box(points: Array, yaw: float, size: Array) -> Start:
    """Turn by `yaw`, scale the length to the box's, centre on the box, stand on its floor.

    Args:
        points: (N, 3) surface of the asset, z up.
        yaw: radians.
        size: (3,) length, width, height of the box, metres.
    """
    rotation = se3.rotation_z(yaw)
    low, high = bounds(points @ rotation.T)
    scale = float(size[0] / (high[0] - low[0]))
    centre = (low + high) / 2 * scale
    bottom = float((points @ rotation.T)[:, 2].min()) * scale
    shift = np.array([-centre[0], -centre[1], -size[2] / 2 - bottom])
    return Start(yaw, scale, se3.from_rotation_translation(rotation, shift))


def box_misfit(sides: Array, size: Array) -> float:
    """Sum of the logs of width and height over those of a box (3,) of the same length."""
    return float(np.abs(np.log(sides[1:] / size[1:])).sum())


@dataclass(frozen=True)
class PlacementReport:
    """How an asset came to stand in its box."""

    axes: str  # convention the asset came in
    yaw: float  # angle by which it was turned after that, radians in [-pi, pi)
    scale: float  # asset units to metres, refinement included
    # (3,) metres by which the refinement moved it from the middle of the box's floor.
    shift: tuple[float, float, float]
    # evidence for the orientation nearest to the declared forward axis, in units.
    votes: dict[str, float]
    flipped: bool  # whether the votes turned it half around
    # overlap_before, overlap: mean intersection over union with the masks, before and after the
    # refinement.
    overlap_before: float
    overlap: float
    colour: float  # mean absolute difference of colours to the views, see `agreement.PoseAgreement`
    # width_over_box, height_over_box: extents at the scale of the length over the box's.
    width_over_box: float
    height_over_box: float


@dataclass(frozen=True)
class PlacedAsset:
    """Gaussians in the actor frame (box centre, x forward, y left, z up; metres), and how."""

    gaussians: Gaussians
    report: PlacementReport


def place_asset(asset: Asset, size: ArrayLike, observations: Sequence[Observation]) -> PlacedAsset:
    """Place an asset in a box by the views that it was made from.

    A convention may declare where the front is: then only half turns are considered, and the
    views must speak against the declared one by more than three units of evidence.

    Args:
        size: (3,) length, width, height of the box, metres.
        observations: conditioning views with cameras, at least one.

    Raises:
        InputError: see `stood_up`.
        ValueError: no observation.
    """
    if not observations:
        raise ValueError("place_asset: at least one observation is needed")
    size = np.asarray(size, np.float64)
    gaussians, surface = stood_up(asset)
    points = surface.points
    search = _Search(gaussians, asset.low_pass, points, size, observations)
    declared = asset.axes.declares_front
    first = 0.0 if declared else search.best_yaw()
    starts = [search.start(first), search.start(first + np.pi)]
    if not declared:  # each of both may have its own best yaw
        starts = [search.finest(start.yaw) for start in starts]
    agreements = [search.agreement(start) for start in starts]
    votes = front_votes(agreements[0], agreements[1], declared=False, heading=0.0)
    votes["heading"] = _DECLARED if declared else 0.0
    flipped = sum(votes.values()) < 0
    start, before = starts[int(flipped)], agreements[int(flipped)]
    grow, shift = search.refine(start)
    placed = search.placed(start, grow, shift)
    overlap, colour = search.compare(placed)
    sides = extent(points @ se3.rotation_z(start.yaw).T) * start.scale
    return PlacedAsset(
        placed,
        PlacementReport(
            axes=asset.axes.name,
            yaw=float((start.yaw + np.pi) % (2 * np.pi) - np.pi),
            scale=start.scale * grow,
            shift=triple(shift),
            votes=votes,
            flipped=flipped,
            overlap_before=before.silhouette,
            overlap=overlap,
            colour=colour,
            width_over_box=float(sides[1] / size[1]),
            height_over_box=float(sides[2] / size[2]),
        ),
    )


@dataclass(frozen=True)
class _Search:
    """Trials of one asset against its views.

    The Gaussians are upright, in the asset's units; `points` (N, 3) are its outer surface.
    """

    gaussians: Gaussians
    low_pass: LowPass
    points: Array
    size: Array
    observations: Sequence[Observation]

    def start(self, yaw: float) -> Start:
        return stand_on_box(self.points, yaw, self.size)

    def placed(
        self, start: Start, grow: float = 1.0, shift: ArrayLike = (0.0, 0.0, 0.0)
    ) -> Gaussians:
        """The asset at a start, then scaled about the middle of the box's floor and moved."""
        foot = np.array([0.0, 0.0, -self.size[2] / 2])
        matrix = start.matrix.copy()
        matrix[:3, 3] = grow * (matrix[:3, 3] - foot) + foot + np.asarray(shift)
        return self.gaussians.transformed(torch.from_numpy(matrix), start.scale * grow)

    def compare(self, placed: Gaussians) -> tuple[float, float]:
        """Overlap of silhouettes and difference of colours, means over the views."""
        both = [compare_views(placed, self.low_pass, one) for one in self.observations]
        overlap, colour = np.mean(both, axis=0)
        return float(overlap), float(colour)

    def agreement(self, start: Start) -> PoseAgreement:
        return PoseAgreement(None, *self.compare(self.placed(start)))

    def cost(self, start: Start) -> float:
        """How badly a start explains the views and fills the box, in units."""
        overlap, colour = self.compare(self.placed(start))
        sides = extent(self.points @ se3.rotation_z(start.yaw).T) * start.scale
        misfit = box_misfit(sides, self.size)
        return (1 - overlap) / _UNITS[0] + colour / _UNITS[1] + misfit / _UNITS[2]

    def best_yaw(self) -> float:
        """The yaw of least cost, of the circle in steps of 15 degrees."""
        return min((self.start(yaw) for yaw in COARSE_YAWS), key=self.cost).yaw

    def finest(self, yaw: float) -> Start:
        """The best start within half a coarse step of a yaw."""
        return min((self.start(float(yaw + step)) for step in FINE_YAWS), key=self.cost)

    def refine(self, start: Start) -> tuple[float, Array]:
        """Factor and shift (3,) in metres that make the silhouettes overlap most, near none."""

        def cost(x: Array) -> float:
            placed = self.placed(start, float(np.exp(x[0] * _SPREAD[0])), x[1:] * _SPREAD[1:])
            return _OVERLAP_WEIGHT * (1 - self.compare(placed)[0]) + 0.5 * float(x @ x)

        best = minimum(cost, 4, _EVALUATIONS, xatol=0.05, fatol=0.02)
        return float(np.exp(best[0] * _SPREAD[0])), best[1:] * _SPREAD[1:]


def minimum(
    cost: Callable[[Array], float], count: int, evaluations: int, xatol: float, fatol: float
) -> Array:
    """Where a function of `count` numbers is least, near 0; one is a usual deviation."""
    simplex = np.concatenate([np.zeros((1, count)), 0.6 * np.eye(count)])
    options = {"initial_simplex": simplex, "maxfev": evaluations, "xatol": xatol, "fatol": fatol}
    return minimize(cost, np.zeros(count), method="Nelder-Mead", options=options).x
