"""The ego trajectory of a nuScenes scene: the poses of all its images and sweeps in one."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path

import numpy as np

from recast.errors import InputError
from recast.logs import motion
from recast.logs.importers.nuscenes_frames import Sensor
from recast.logs.importers.nuscenes_sensors import pose_of
from recast.logs.importers.nuscenes_tables import EgoPoseRow, SampleRow, linked
from recast.logs.types import Array, Trajectory

LONGEST_GAP_US = 1_000_000
FASTEST = 100.0
"""Metres a second that the ego may go between two poses, beside a metre of jitter."""
_MEND = "take all tables from one metadata archive"


def read_ego(
    tables: Path, samples: Sequence[SampleRow], sensors: Sequence[Sensor]
) -> tuple[Trajectory, Array]:
    """The ego trajectory near the origin, and the offset taken off it.

    The dataset's ego frame has its origin on the ground under the rear axle, as our rig frame.

    Raises:
        InputError: poses are missing, broken, far apart in time, not all of one frame, or do not
            cover the frames.
    """
    frames = [frame for sensor in sensors for frame in sensor.frames]
    rows = linked(tables, "ego_pose", EgoPoseRow, frames, "sample_data", "ego_pose_token")
    path = tables / "ego_pose.json"
    ordered = sorted(rows.values(), key=lambda row: row.timestamp)
    if len({row.timestamp for row in ordered}) < 2:
        raise InputError(path, "rows", f"{len(ordered)} of this scene, 2 are needed", _MEND)
    placed = np.stack([pose_of(path, row) for row in ordered])
    kept = _one_for_each_time(path, ordered, placed)
    times = np.array([ordered[i].timestamp for i in kept], np.int64)
    poses = placed[kept]
    offset: Array = poses[0, :3, 3].copy()
    poses[:, :3, 3] -= offset
    sensed = [frame.timestamp for frame in frames] + [sample.timestamp for sample in samples]
    trajectory = motion.extended(Trajectory(times, poses), min(sensed), max(sensed))
    for table, timed in (("sample", samples), ("sample_data", frames)):
        for row in timed:
            if not trajectory.covers(row.timestamp):
                problem = f"{row.timestamp} lies outside the scene's ego poses"
                where = tables / f"{table}.json"
                raise InputError(where, f"token {row.token}: timestamp", problem, _MEND)
    return trajectory, offset


def _one_for_each_time(path: Path, ordered: Sequence[EgoPoseRow], placed: Array) -> list[int]:
    kept = [0]
    for i in range(1, len(ordered)):
        passed = ordered[i].timestamp - ordered[kept[-1]].timestamp
        moved = float(np.linalg.norm(placed[i, :3, 3] - placed[kept[-1], :3, 3]))
        if moved > 1.0 + FASTEST * passed / 1e6:
            problem = f"{moved:.0f} m from the pose {passed / 1e6:.2f} s before: mixed frames"
            raise InputError(path, f"token {ordered[i].token}: translation", problem, _MEND)
        if passed > LONGEST_GAP_US:
            problem = f"comes {passed / 1e6:.1f} s after the pose before"
            field = f"token {ordered[i].token}: timestamp"
            raise InputError(path, field, problem, "use a scene without the gap")
        if passed > 0:
            kept.append(i)
    return kept
