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
from recast.logs.importers.pose_jumps import first_jump
from recast.logs.types import Array, Trajectory

LONGEST_GAP_US = 1_000_000
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
    all_times = np.array([row.timestamp for row in ordered], np.int64)
    jump = first_jump(all_times, placed)
    if jump is not None:
        problem = f"is {jump[1]:.0f} m from the pose before: mixed coordinate frames"
        raise InputError(path, f"token {ordered[jump[0]].token}: translation", problem, _MEND)
    times, first = np.unique(all_times, return_index=True)
    gaps = np.flatnonzero(np.diff(times) > LONGEST_GAP_US)
    if len(gaps):
        problem = f"the next pose comes {(times[gaps[0] + 1] - times[gaps[0]]) / 1e6:.1f} s later"
        field = f"token {ordered[first[gaps[0]]].token}: timestamp"
        raise InputError(path, field, problem, "use a scene without the gap")
    poses = placed[first]
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
