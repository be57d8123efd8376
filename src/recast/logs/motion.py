"""Motion between measurements: LiDAR points in one frame, of the rig or of a tracked object."""

from __future__ import annotations

from collections.abc import Mapping
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from recast.geometry import se3
from recast.logs.types import (
    Array,
    DrivingLog,
    Float32Array,
    Int64Array,
    LidarSweep,
    Track,
    Trajectory,
)

MAX_EXTENSION_US = 150_000
NEAREST_LABEL_US = 160_000  # a sweep farther from every label tells nothing certain
LONGEST_TABLE_US = 1_000_000  # a turn of a scanner has a tenth


def compensate(
    points: Array, timestamps_us: Int64Array, world_from_rig: Trajectory, reference_us: int
) -> Array:
    """Points (N, 3) of the rig frames at `timestamps_us` (N,), in the rig frame at `reference_us`.
    Raises ValueError: a time lies outside the trajectory."""
    times, index = distinct_times(timestamps_us)
    moved = se3.inverse(world_from_rig.at(reference_us)) @ world_from_rig.at(times)
    return _apply_each(moved, index, points)


def distort(
    points: Array, timestamps_us: Int64Array, world_from_rig: Trajectory, reference_us: int
) -> Array:
    """Inverse of `compensate`: from the rig frame at `reference_us` to those at `timestamps_us`."""
    times, index = distinct_times(timestamps_us)
    moved = se3.inverse(world_from_rig.at(times)) @ world_from_rig.at(reference_us)
    return _apply_each(moved, index, points)


def distinct_times(timestamps_us: Int64Array) -> tuple[Int64Array, Int64Array]:
    """What `np.unique` gives with `return_inverse`: times (T,) in order, and each one's place (N,).

    The points of a sweep share few times within a tenth of a second, so a table of microseconds
    finds them without sorting.
    """
    if len(timestamps_us) == 0:
        return np.unique(timestamps_us, return_inverse=True)
    first = timestamps_us.min()
    span = int(timestamps_us.max()) - int(first) + 1
    if span > max(LONGEST_TABLE_US, len(timestamps_us)):
        return np.unique(timestamps_us, return_inverse=True)
    offsets = timestamps_us - first
    table = np.zeros(span, bool)
    table[offsets] = True
    places: Int64Array = np.cumsum(table, dtype=np.int64) - 1
    return first + np.flatnonzero(table), places[offsets]


def _apply_each(transforms: Array, index: Int64Array, points: Array) -> Array:
    chosen = np.take(transforms[:, :3].reshape(-1, 12), index, axis=0).reshape(-1, 3, 4)
    points = np.asarray(points, np.float64)
    return np.einsum("nij,nj->ni", chosen[:, :, :3], points) + chosen[:, :, 3]


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
    return at @ se3.exp(twist * (ahead_us / interval_us))


def logged_velocity(trajectory: Trajectory, timestamps_us: Int64Array | int, step_us: int) -> Array:
    """Velocities (..., 2) in the world, m/s, at times (...) within a trajectory.

    Differences over `step_us` to each side, less at its ends.
    """
    ends = trajectory.timestamps_us[[0, -1]]
    around = np.clip([timestamps_us - step_us, timestamps_us + step_us], *ends)
    before, after = trajectory.at(around)[..., :2, 3]
    seconds: Array = np.maximum((around[1] - around[0]) * 1e-6, 1e-6)
    return (after - before) / seconds[..., None]


class TrackPoints(NamedTuple):
    """Points on one object.

    Attributes:
        points: (N, 3) float32 metres, actor-local frame.
        sweep: (N,) int32, index of the sweep, counted through all LiDARs in the log's order.
        intensity: (N,) float32.
    """

    points: Float32Array
    sweep: NDArray[np.int32]
    intensity: Float32Array


def track_points(
    log: DrivingLog, track: Track, margin: float = 0.15, clearance: float = 0.1
) -> TrackPoints:
    """LiDAR points inside a track's box over all sweeps, in the actor-local frame.

    Every point is put into the box as it stood when the point was measured, so moving objects
    come out sharp.

    Args:
        margin: metres by which sides and top are moved outwards; labelled boxes are often that
            much too tight.
        clearance: metres by which the bottom is raised, to leave the road out.
    """
    return all_track_points(log, {track.track_id: track}, margin, clearance)[track.track_id]


def all_track_points(
    log: DrivingLog, tracks: Mapping[str, Track], margin: float = 0.15, clearance: float = 0.1
) -> dict[str, TrackPoints]:
    """`track_points` of many tracks; reads every sweep once."""
    found: dict[str, list[TrackPoints]] = {name: [_NOTHING] for name in tracks}
    count = 0
    for lidar in log.lidars.values():
        for index, time in enumerate(lidar.timestamps_us.tolist()):
            labelled = {
                name: track
                for name, track in tracks.items()
                if np.abs(track.trajectory.timestamps_us - time).min() <= NEAREST_LABEL_US
            }
            if not labelled:
                continue
            sweep = lidar.sweeps[index]
            for name, track in labelled.items():
                local, intensity = _in_actor(log, track, sweep, margin)
                high = track.size / 2 + margin
                low = -high
                low[2] = -track.size[2] / 2 + clearance
                inside = np.all((local >= low) & (local <= high), axis=1)
                number = np.full(np.count_nonzero(inside), count + index, np.int32)
                found[name].append(
                    TrackPoints(local[inside].astype(np.float32), number, intensity[inside])
                )
        count += len(lidar.timestamps_us)
    return {name: _joined(parts) for name, parts in found.items()}


_NOTHING = TrackPoints(np.zeros((0, 3), np.float32), np.zeros(0, np.int32), np.zeros(0, np.float32))


def _joined(parts: list[TrackPoints]) -> TrackPoints:
    return TrackPoints(*(np.concatenate(columns) for columns in zip(*parts, strict=True)))


def _in_actor(
    log: DrivingLog, track: Track, sweep: LidarSweep, margin: float
) -> tuple[Array, Float32Array]:
    """Points (N, 3) near the object in its frame, and their intensities (N,)."""
    labelled = track.trajectory.timestamps_us[[0, -1]]
    pose = track.trajectory.at(np.clip(sweep.timestamp_us, *labelled))
    world_from_rig = log.world_from_rig.at(sweep.timestamp_us)
    centre = se3.apply(se3.inverse(world_from_rig), pose[None, :3, 3])[0]
    # A car at 50 m/s moves 2.5 m in half a turn: enough to meet points at the edge of the sweep.
    reach = float(np.linalg.norm(track.size)) / 2 + margin + 2.5
    near = _within(sweep.points, centre, reach)
    points = se3.apply(world_from_rig, sweep.points[near])
    if sweep.point_timestamps_us is None:
        return se3.apply(se3.inverse(pose), points), sweep.intensity[near]
    # Labels begin and end within a turn of the sweep: hold the box there, it moves centimetres.
    times = np.clip(sweep.point_timestamps_us[near], *labelled)
    moments, index = distinct_times(times)
    actor_from_world = se3.inverse(track.trajectory.at(moments))
    return _apply_each(actor_from_world, index, points), sweep.intensity[near]


def _within(points: Float32Array, centre: Array, reach: float) -> NDArray[np.intp]:
    """Indices of the points (N, 3) nearer than `reach` to `centre`.

    Along x the most fall out, at a tenth of the cost of a distance.
    """
    beside = np.flatnonzero(np.abs(points[:, 0] - centre[0]) < reach)
    return beside[np.linalg.norm(points[beside] - centre, axis=1) < reach]
