"""Free space: cells of a vehicle's box that LiDAR rays passed through."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import ArrayLike, NDArray
from scipy.spatial import cKDTree

from recast.geometry import se3
from recast.logs import DrivingLog, Track

Array = NDArray[np.float64]

EDGE = 0.08
"""Edge of a cell, metres."""
_RAYS = 2  # that passed: one may have met its target at the wrong time
_NEAR_HIT = 0.12  # metres around a hit that are not free: noise, and the pose of a moving vehicle
_BEHIND = 0.5  # metres beyond the box at which a ray must end: it may have ended on the far side
_GROWTH = 0.1  # metres by which the box is grown


@dataclass(frozen=True)
class FreeSpace:
    """Cells that are seen to be empty.

    Attributes:
        centres: (M, 3) float32, object frame, metres.
        edge: of a cell, metres.
    """

    centres: NDArray[np.float32]
    edge: float = EDGE

    def holds(self, points: ArrayLike) -> NDArray[np.bool_]:
        """Which points (N, 3) lie in a free cell."""
        points = np.asarray(points, np.float64)
        if len(self.centres) == 0:
            return np.zeros(len(points), bool)
        near, _ = cKDTree(self.centres).query(points, p=np.inf)
        inside: NDArray[np.bool_] = near <= self.edge / 2 + 1e-6
        return inside


def free_space(log: DrivingLog, track: Track, hits: ArrayLike) -> FreeSpace:
    """Cells of a track's box through which at least two rays passed to what lies behind.

    A ray that ends in the box, or less than half a metre beyond it, says nothing: it may have gone
    through glass. So may one that passes two windows; cells near a hit are not free.

    Args:
        hits: (N, 3) LiDAR points on the vehicle, object frame.
    """
    hits = np.asarray(hits, np.float64)
    half = np.asarray(track.size, np.float64) / 2 + _GROWTH
    shape = np.ceil(2 * half / EDGE).astype(int)
    passed = np.zeros(int(np.prod(shape)), np.int32)
    for lidar in log.lidars.values():
        for index, time in enumerate(lidar.timestamps_us.tolist()):
            if not track.trajectory.covers(time):
                continue
            object_from_rig = se3.inverse(track.trajectory.at(time)) @ log.world_from_rig.at(time)
            origin = se3.apply(object_from_rig, lidar.rig_from_lidar[:3, 3][None])[0]
            ends = se3.apply(object_from_rig, _towards(lidar.sweeps[index].points, object_from_rig))
            for cells in _crossed(origin, ends, half, shape):
                passed[cells] += 1
    free = np.flatnonzero(passed >= _RAYS)
    centres = (np.stack(np.unravel_index(free, shape), -1) + 0.5) * EDGE - half
    if len(hits) and len(centres):
        distance, _ = cKDTree(hits).query(centres)
        centres = centres[distance > _NEAR_HIT]
    return FreeSpace(centres.astype(np.float32).reshape(-1, 3))


def _towards(points: NDArray[np.float32], object_from_rig: Array) -> Array:
    """Those points (N, 3) of a sweep, rig frame, that lie on the box's side of the rig."""
    middle = se3.inverse(object_from_rig)[:3, 3]
    distance = float(np.linalg.norm(middle))
    cosine = points @ (middle / max(distance, 1e-9)) / np.linalg.norm(points, axis=1).clip(1e-9)
    # half the diagonal of a long vehicle, seen from its distance
    widest = np.cos(min(np.arctan2(8.0, distance) + 0.05, np.pi / 2))
    return np.asarray(points[cosine > widest], np.float64)


def _crossed(origin: Array, ends: Array, half: Array, shape: Array) -> list[NDArray[np.int64]]:
    """Cells that each ray passes which ends beyond the box, (C,) flat indices a ray."""
    step = ends - origin
    length = np.linalg.norm(step, axis=1)
    safe = np.where(np.abs(step) < 1e-9, 1e-9, step)
    first, last = (-half - origin) / safe, (half - origin) / safe
    enter = np.minimum(first, last).max(axis=1)
    leave = np.maximum(first, last).min(axis=1)
    through = (enter < leave) & (enter > 0) & (leave < 1 - _BEHIND / length.clip(1e-9))
    found = []
    for a, b, way, metres in zip(
        enter[through], leave[through], step[through], length[through], strict=True
    ):
        count = int((b - a) * metres / (0.5 * EDGE)) + 1
        points = origin + np.linspace(a, b, count)[:, None] * way
        cells = np.floor((points + half) / EDGE).astype(np.int64).clip(0, shape - 1)
        found.append(np.unique(np.ravel_multi_index(tuple(cells.T), tuple(shape))))
    return found
