"""DAC and R_c: whether the ego stays on the drivable area, and how much of the route it covers."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
import shapely
from numpy.typing import ArrayLike

from recast.arrays import Array
from recast.geometry import Polyline, boxes
from recast.metrics.table import Metric, invalid

TOLERANCE = 0.3
"""Metres that a corner may leave the drivable area."""
_CORNERS = ("front left", "rear left", "rear right", "front right")
_SHORTEST_ROUTE = 1.0
"""Metres of remaining route below which a share of it says nothing."""


@dataclass(frozen=True)
class DrivableArea:
    """DAC of a rollout.

    Attributes:
        dac: 1 while every corner stays within 0.3 m of the drivable area, else 0.
        distance: (S+1, 4) metres from each corner to the area, 0 inside; corners front left, rear
            left, rear right, front right. None without a map.
        first_step: first state with a corner too far out, or None.
    """

    dac: Metric
    distance: Array | None
    first_step: int | None


def drivable_area_compliance(
    ego_boxes: ArrayLike,
    ego_size: ArrayLike,
    region: shapely.Geometry | None,
    dt: float,
    tolerance: float = TOLERANCE,
) -> DrivableArea:
    """DAC: 1 iff all four corners lie within `tolerance` metres of the region in every state.

    Args:
        ego_boxes: (S+1, 3) x, y, heading of the ego's box centre.
        ego_size: (2,) length and width in metres.
        region: region from `drivable_region`; None makes the metric invalid.
        dt: seconds between states.
    """
    if region is None:
        return DrivableArea(invalid("no drivable area in the map"), None, None)
    length, width = np.asarray(ego_size, np.float64)[:2]
    corners = boxes.bev_corners(ego_boxes, length, width)
    shapely.prepare(region)
    distance = np.asarray(shapely.distance(region, shapely.points(corners)), np.float64)
    outside = np.flatnonzero(np.any(distance > tolerance, axis=1))
    if len(outside) == 0:
        return DrivableArea(Metric(1.0), distance, None)
    first = int(outside[0])
    corner = int(np.argmax(distance[first]))
    reason = (
        f"{_CORNERS[corner]} corner {distance[first, corner]:.2f} m outside "
        f"at step {first} ({first * dt:.1f} s); {distance.max():.2f} m at the worst"
    )
    return DrivableArea(Metric(0.0, reason), distance, first)


@dataclass(frozen=True)
class RouteCompletion:
    """R_c of a rollout, as shares between 0 and 1.

    Attributes:
        r_c: path length driven over the remaining route length.
        r_c_projection: advance of the projection onto the route over the same length.
        route_length: metres from the start pose's projection to the end of the log.
    """

    r_c: Metric
    r_c_projection: Metric
    route_length: float


def route_completion(
    ego_poses: ArrayLike, route: ArrayLike, collision_step: int | None = None
) -> RouteCompletion:
    """R_c = min(1, D / L), D driven up to the first collision, L the route that was left at start.

    Args:
        ego_poses: (S+1, >=2) rear axle.
        route: (R, 2) the logged ego path to the end of the log, rear axle.
        collision_step: step at which counting stops, or None to count all.
    """
    end = None if collision_step is None else collision_step + 1
    path = np.asarray(ego_poses, np.float64)[:end, :2]
    try:
        line = Polyline.from_points(route)
    except ValueError:
        return _no_route(0.0)
    along = line.follow(path)
    remaining = line.length - float(along[0])
    if remaining < _SHORTEST_ROUTE:
        return _no_route(remaining)
    driven = float(np.sum(np.linalg.norm(np.diff(path, axis=0), axis=1)))
    advanced = max(float(along[-1] - along[0]), 0.0)
    return RouteCompletion(
        _share(driven, remaining, collision_step),
        _share(advanced, remaining, collision_step),
        remaining,
    )


def _share(covered: float, remaining: float, collision_step: int | None) -> Metric:
    share = min(1.0, covered / remaining)
    reason = None
    if share < 1.0:
        until = "" if collision_step is None else f" until the collision at step {collision_step}"
        reason = f"{covered:.1f} m of {remaining:.1f} m{until}"
    return Metric(share, reason)


def _no_route(length: float) -> RouteCompletion:
    metric = invalid(f"only {length:.2f} m of the logged route are left")
    return RouteCompletion(metric, metric, length)
