"""Ego motion during a LiDAR turn: points measured at many times, told in one rig frame."""

from __future__ import annotations

import numpy as np

from recast.geometry import se3
from recast.logs.types import Array, Int64Array, Trajectory


def compensate(
    points: Array, timestamps_us: Int64Array, world_from_rig: Trajectory, reference_us: int
) -> Array:
    """Points (N, 3) of the rig frames at `timestamps_us` (N,), in the rig frame at `reference_us`.

    Raises:
        ValueError: a time lies outside the trajectory.
    """
    times, index = np.unique(timestamps_us, return_inverse=True)
    moved = se3.inverse(world_from_rig.at(reference_us)) @ world_from_rig.at(times)
    return _apply_each(moved, index, points)


def distort(
    points: Array, timestamps_us: Int64Array, world_from_rig: Trajectory, reference_us: int
) -> Array:
    """Inverse of `compensate`: from the rig frame at `reference_us` to those at `timestamps_us`."""
    times, index = np.unique(timestamps_us, return_inverse=True)
    moved = se3.inverse(world_from_rig.at(times)) @ world_from_rig.at(reference_us)
    return _apply_each(moved, index, points)


def _apply_each(transforms: Array, index: Int64Array, points: Array) -> Array:
    chosen = transforms[index]
    points = np.asarray(points, np.float64)
    moved: Array = np.einsum("nij,nj->ni", chosen[:, :3, :3], points) + chosen[:, :3, 3]
    return moved
