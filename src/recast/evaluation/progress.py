"""R_c: how much of the logged route the ego covered before it hit something."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import ArrayLike, NDArray

from recast.evaluation.metric import Metric, invalid
from recast.geometry import Polyline

Array = NDArray[np.float64]

_SHORTEST_ROUTE = 1.0
"""Metres of remaining route below which a share of it says nothing."""


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
        collision_step: where to stop counting, or None to count all.
    """
    end = None if collision_step is None else collision_step + 1
    path = np.asarray(ego_poses, np.float64)[:end, :2]
    try:
        line = Polyline.from_points(route)
    except ValueError:
        return _no_route(0.0)
    along, _ = line.to_frenet(path[[0, -1]])
    remaining = line.length - float(along[0])
    if remaining < _SHORTEST_ROUTE:
        return _no_route(remaining)
    driven = float(np.sum(np.linalg.norm(np.diff(path, axis=0), axis=1)))
    advanced = max(float(along[1] - along[0]), 0.0)
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
