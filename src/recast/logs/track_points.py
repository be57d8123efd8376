"""LiDAR points on a tracked object, gathered over all sweeps in the object's own frame."""

from __future__ import annotations

from collections.abc import Mapping
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from recast.geometry import se3
from recast.logs.types import Array, DrivingLog, Float32Array, LidarSweep, Track

NEAREST_LABEL_US = 160_000  # a sweep farther from every label tells nothing certain


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
    reach = np.linalg.norm(track.size) / 2 + margin + 2.5
    near = np.linalg.norm(sweep.points - centre, axis=1) < reach
    points = se3.apply(world_from_rig, sweep.points[near])
    if sweep.point_timestamps_us is None:
        return se3.apply(se3.inverse(pose), points), sweep.intensity[near]
    # Labels begin and end within a turn of the sweep: hold the box there, it moves centimetres.
    times = np.clip(sweep.point_timestamps_us[near], *labelled)
    moments, index = np.unique(times, return_inverse=True)
    actor_from_world = se3.inverse(track.trajectory.at(moments))[index]
    local: Array = np.einsum("nij,nj->ni", actor_from_world[:, :3, :3], points)
    return local + actor_from_world[:, :3, 3], sweep.intensity[near]
