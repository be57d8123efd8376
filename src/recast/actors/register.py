"""Registration: a generated vehicle to the logged box and its LiDAR points.

Axes, isotropic scale from the length, yaw over the whole circle with front and back decided by
evidence, then constrained ICP; the wheels stand on the box's ground plane throughout.
"""

from __future__ import annotations

import numpy as np
import torch
from scipy.spatial import cKDTree

from recast.actors.actor import Actor, FrontEvidence, Provenance, RegistrationReport, triple
from recast.actors.drawing import compare_views
from recast.actors.generate import Asset
from recast.actors.icp import FitSurface, IcpLimits, align, bounds, extent, fit_of, thinned
from recast.actors.insert import contact_shadow
from recast.actors.observation import SIDES, Observation
from recast.actors.observe import require_points
from recast.actors.place import (
    COARSE_YAWS,
    FINE_YAWS,
    PoseAgreement,
    Start,
    front_votes,
    heading_agreement,
    stand_on_box,
    stood_up,
)
from recast.arrays import Array
from recast.geometry import se3
from recast.logs import DrivingLog, Track, track_points
from recast.splats import Gaussians, LowPass

_LIDAR_POINTS = 6000
_SURFACE_POINTS = 4000  # used in the yaw search
_SIDE_BAND = 0.25  # metres inside a face of the box within which points count for that side


def register(asset: Asset, observation: Observation, log: DrivingLog, track: Track) -> Actor:
    """Place an asset in the actor frame of a track.

    Args:
        observation: observation that the asset was made from.
        track: the vehicle it stands for.

    Raises:
        InputError: fewer than 20 LiDAR points on the track, or see `stood_up`.
    """
    same = observation.track_id == track.track_id  # reading all sweeps again takes seconds
    points = observation.points if same else track_points(log, track).points
    require_points(points, log, track.track_id)
    lidar = thinned(np.asarray(points, np.float64), _LIDAR_POINTS)
    size = np.asarray(track.size, np.float64)
    gaussians, surface = stood_up(asset)
    start, front = _orientation(gaussians, surface, lidar, size, observation, track, asset)
    placed = start.apply(surface)
    before = fit_of(placed.points, lidar)
    free = align(placed, lidar)
    result = align(placed, lidar, floor=-size[2] / 2)
    after = fit_of(result.apply(placed.points), lidar)

    scale = start.scale * result.scale
    matrix = result.matrix @ se3.from_rotation_translation(
        start.matrix[:3, :3], start.matrix[:3, 3] * result.scale
    )
    registered = gaussians.transformed(torch.from_numpy(matrix), scale)
    sides = extent(placed.points)
    low, high = bounds(result.apply(placed.points))
    report = RegistrationReport(
        axes=asset.axes.name,
        initial_scale=start.scale,
        initial_yaw=start.yaw,
        width_over_box=float(sides[1] / size[1]),
        height_over_box=float(sides[2] / size[2]),
        front=front,
        before=before,
        after=after,
        icp_scale=result.scale,
        icp_yaw=result.yaw,
        icp_translation=triple(result.translation),
        icp_iterations=result.iterations,
        icp_converged=result.converged,
        ground_gap=float(free.apply(placed.points)[:, 2].min() + size[2] / 2),
        lidar_points=len(points),
        lidar_by_side=lidar_by_side(np.asarray(points, np.float64), size),
    )
    return Actor(
        track_id=track.track_id,
        category=track.category,
        size=size,
        gaussians=registered,
        shadow=contact_shadow(low, high, floor=-size[2] / 2),
        provenance=Provenance.of(asset, observation, report),
        source=observation.rgba,
        low_pass=asset.low_pass,
    )


def lidar_by_side(points: Array, size: Array) -> dict[str, int]:
    """LiDAR points (N, 3) within 0.25 m of each face of the box, or beyond it."""
    half = size / 2
    return {
        name: int(np.sum(sign * points[:, axis] > half[axis] - _SIDE_BAND))
        for name, (axis, sign) in SIDES.items()
    }


def _orientation(
    gaussians: Gaussians,
    surface: FitSurface,
    lidar: Array,
    size: Array,
    observation: Observation,
    track: Track,
    asset: Asset,
) -> tuple[Start, FrontEvidence]:
    """Search the yaw over the circle, then decide between the best one and its opposite."""
    sparse = thinned(surface.points, _SURFACE_POINTS)
    few = thinned(lidar, 1500)

    def cost(yaw: float) -> float:
        return _search_cost(sparse, few, stand_on_box(sparse, yaw, size), size)

    best = min(min(COARSE_YAWS, key=cost) + FINE_YAWS, key=cost)
    if np.cos(best) < 0:
        best -= np.pi
    best = float((best + np.pi) % (2 * np.pi) - np.pi)

    starts = [
        stand_on_box(surface.points, best, size),
        stand_on_box(surface.points, best + np.pi, size),
    ]
    agreements = [
        _agreement(gaussians, asset.low_pass, surface, lidar, start, observation)
        for start in starts
    ]
    declared = asset.axes.declares_front
    heading = heading_agreement(track)
    votes = front_votes(agreements[0], agreements[1], declared, heading)
    total = sum(votes.values())
    chosen = 0 if total >= 0 else 1
    return starts[chosen], FrontEvidence(
        votes=votes, flipped=chosen == 1, heading_agreement=heading, margin=abs(total)
    )


def _search_cost(points: Array, lidar: Array, start: Start, size: Array) -> float:
    """Trimmed mean distance plus what width and height miss of the box, metres."""
    placed = se3.apply(start.matrix, points * start.scale)
    distance, _ = cKDTree(placed).query(lidar)
    kept = np.sort(distance)[: int(0.85 * len(distance)) or 1]
    misfit = np.abs(np.log(extent(placed)[1:] / size[1:])) * size[1:]
    return float(kept.mean() + 0.1 * misfit.sum())


def _agreement(
    gaussians: Gaussians,
    low_pass: LowPass,
    surface: FitSurface,
    lidar: Array,
    start: Start,
    observation: Observation,
) -> PoseAgreement:
    """What speaks for one orientation after a short alignment."""
    start = aligned(surface, lidar, start, observation.size)
    moved = gaussians.transformed(torch.from_numpy(start.matrix), start.scale)
    silhouette, colour = compare_views(moved, low_pass, observation)
    return PoseAgreement(fit_of(start.apply(surface).points, lidar), silhouette, colour)


def aligned(surface: FitSurface, lidar: Array, start: Start, size: Array) -> Start:
    """A start after a short alignment to LiDAR points (N, 3) in a box of `size` (3,)."""
    placed, few = start.apply(surface), thinned(lidar, 1500)
    result = align(placed, few, IcpLimits(iterations=15), floor=-size[2] / 2)
    matrix = result.matrix @ se3.from_rotation_translation(
        start.matrix[:3, :3], start.matrix[:3, 3] * result.scale
    )
    return Start(start.yaw, start.scale * result.scale, matrix)
