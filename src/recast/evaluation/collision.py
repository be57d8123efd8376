"""NC: whether the ego's box ever overlaps that of a controlled actor."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
import shapely
from numpy.typing import ArrayLike, NDArray

from recast.evaluation.metric import Metric
from recast.geometry import boxes, se2

Array = NDArray[np.float64]
BoolArray = NDArray[np.bool_]

TOUCHING = 1e-9
"""Overlap in square metres up to which boxes merely touch."""


@dataclass(frozen=True)
class Collision:
    """NC of a rollout.

    Attributes:
        nc: 1 without any overlap, else 0.
        overlap: (S+1,) square metres common to both boxes; with several actors the largest.
        first_step: first state with an overlap, or None.
    """

    nc: Metric
    overlap: Array
    first_step: int | None


def overlap_areas(
    poses_a: ArrayLike, size_a: ArrayLike, poses_b: ArrayLike, size_b: ArrayLike
) -> Array:
    """Bird's-eye overlap (...) in square metres of boxes, pair by pair.

    The same as `boxes.bev_overlap_area`, for many pairs at once.

    Args:
        poses_a, poses_b: (..., 3) x, y, heading of the box centres.
        size_a, size_b: (>=2,) length and width in metres.
    """
    size_a, size_b = np.asarray(size_a, np.float64)[:2], np.asarray(size_b, np.float64)[:2]
    relative = se2.relative(poses_a, poses_b)  # near the origin: no digits lost to far coordinates
    areas = np.zeros(relative.shape[:-1])
    reach = (np.hypot(*size_a) + np.hypot(*size_b)) / 2
    near = np.hypot(relative[..., 0], relative[..., 1]) <= reach
    first = shapely.polygons(boxes.bev_corners(np.zeros(3), *size_a))
    second = shapely.polygons(boxes.bev_corners(relative[near], *size_b))
    areas[near] = shapely.area(shapely.intersection(first, second))
    return areas


def no_collision(
    ego_boxes: ArrayLike,
    ego_size: ArrayLike,
    actor: ArrayLike,
    actor_size: ArrayLike,
    dt: float,
    name: str = "the actor",
) -> Collision:
    """NC: 1 iff the boxes' overlap is at most 1e-9 m^2 in every state. No fault is assigned.

    Args:
        ego_boxes: (S+1, 3) x, y, heading of the ego's box centre.
        actor: (S+1, >=3) x, y, heading of the actor's box centre.
        ego_size, actor_size: (>=2,) length and width in metres.
        dt: seconds between states.
        name: name of the actor, for the reason.
    """
    overlap = overlap_areas(ego_boxes, ego_size, np.asarray(actor, np.float64)[:, :3], actor_size)
    hits = np.flatnonzero(overlap > TOUCHING)
    if len(hits) == 0:
        return Collision(Metric(1.0), overlap, None)
    first = int(hits[0])
    reason = f"overlaps {name} from step {first} ({first * dt:.1f} s)"
    return Collision(Metric(0.0, reason), overlap, first)


def any_collision(collisions: Sequence[Collision]) -> Collision:
    """NC over several actors: 1 iff the ego meets none of them; the first contact counts.

    Args:
        collisions: those of the same ego with each actor, at least one. Of contacts in one state
            the first in this order gives the reason.
    """
    hit = [one for one in collisions if one.first_step is not None]
    first = min(hit, key=lambda one: one.first_step or 0) if hit else collisions[0]
    overlap: Array = np.max([one.overlap for one in collisions], axis=0)
    return Collision(first.nc, overlap, first.first_step)
