"""Motion between measurements: points of a LiDAR turn in one rig frame, ends of trajectories."""

from __future__ import annotations

import numpy as np

from recast.geometry import se3
from recast.logs.types import Array, Int64Array, Trajectory

MAX_EXTENSION_US = 150_000


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


def extended(trajectory: Trajectory, first_us: int, last_us: int) -> Trajectory:
    """Lengthen a trajectory to cover [first_us, last_us], by at most 0.15 s at either end.

    Sensors start and stop within a cycle of each other, so the first image may come before the
    first pose. The motion of the first (last) interval is continued with a constant twist; a
    single pose is held.
    """
    times, poses = trajectory.timestamps_us, trajectory.poses
    if len(times) == 1:
        times, poses = np.append(times, times[0] + 1), np.concatenate([poses, poses])
    first = max(first_us, int(times[0]) - MAX_EXTENSION_US)
    last = min(last_us, int(times[-1]) + MAX_EXTENSION_US)
    new_times: Int64Array = times
    new_poses = poses
    if first < times[0]:
        start = _continued(poses[1], poses[0], times[0] - times[1], first - times[0])
        new_times = np.concatenate([[first], new_times])
        new_poses = np.concatenate([start[None], new_poses])
    if last > times[-1]:
        end = _continued(poses[-2], poses[-1], times[-1] - times[-2], last - times[-1])
        new_times = np.concatenate([new_times, [last]])
        new_poses = np.concatenate([new_poses, end[None]])
    return Trajectory(new_times.astype(np.int64), new_poses)


def _continued(before: Array, at: Array, interval_us: int, ahead_us: int) -> Array:
    twist = se3.log(se3.inverse(before) @ at)
    moved: Array = at @ se3.exp(twist * (ahead_us / interval_us))
    return moved


def logged_velocity(trajectory: Trajectory, timestamps_us: Int64Array | int, step_us: int) -> Array:
    """Velocities (..., 2) in the world, m/s, at times (...) within a trajectory.

    Differences over `step_us` to each side, less at its ends.
    """
    ends = trajectory.timestamps_us[[0, -1]]
    around = np.clip([timestamps_us - step_us, timestamps_us + step_us], *ends)
    before, after = trajectory.at(around)[..., :2, 3]
    seconds: Array = np.maximum((around[1] - around[0]) * 1e-6, 1e-6)
    velocity: Array = (after - before) / seconds[..., None]
    return velocity
