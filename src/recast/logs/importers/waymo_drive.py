"""A Waymo segment, of either version of the dataset, as a driving log."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path

import numpy as np

from recast.geometry import se3
from recast.logs import motion
from recast.logs.importers.cameras import chosen_cameras
from recast.logs.importers.waymo_cameras import read_cameras, shutter_notes
from recast.logs.importers.waymo_labels import read_tracks
from recast.logs.importers.waymo_lidar import read_lidars
from recast.logs.importers.waymo_map import read_map
from recast.logs.importers.waymo_range_image import TURN_US
from recast.logs.importers.waymo_schema import LICENCE
from recast.logs.importers.waymo_segment import Segment
from recast.logs.types import Array, DrivingLog, Int64Array, Trajectory

LONGEST_GAP_US = 1_000_000
_SAME_POSE = 1e-3
"""Metres (and radians) within which a camera's pose is the frame's own."""


def driving_log(segment: Segment, dataset: str, cameras: Sequence[str] = ()) -> DrivingLog:
    """The log of a segment; images and sweeps stay in its files until asked for.

    Args:
        segment: what was read.
        dataset: its name, for the metadata.
        cameras: names of the cameras to keep; all if empty.

    Raises:
        InputError: a calibration is missing, a sensor's frames do not belong together, there is a
            gap in the drive, or the map is faulty.
    """
    streams = read_cameras(segment)
    chosen = chosen_cameras(Path(segment.name), streams, cameras)
    times = _frame_times(segment)
    trajectory, offset = _ego(segment, times)
    world_from_global = se3.from_rotation_translation(np.eye(3), -offset)
    return DrivingLog(
        name=segment.name,
        cameras={name: streams[name] for name in chosen},
        lidars=read_lidars(segment, times, world_from_global, trajectory),
        world_from_rig=trajectory,
        tracks=read_tracks(segment, world_from_global),
        map=None
        if segment.map is None
        else read_map(segment.map, world_from_global, trajectory.poses[:, :2, 3]),
        world_offset=offset,
        metadata={
            "dataset": dataset,
            "drive": segment.name,
            "licence": LICENCE,
            **segment.notes,
            **shutter_notes(segment),
        },
    )


def _frame_times(segment: Segment) -> Int64Array:
    """Times (F,) of the frames' own poses: the dataset tells only when the turn began.

    In the real frame it is exactly the pose of one camera's image; else the turn's middle is taken.
    """
    times = []
    for frame in segment.frames:
        apart = {
            image.time_us: float(np.abs(se3.inverse(frame.pose) @ image.pose - np.eye(4)).max())
            for image in frame.images.values()
        }
        nearest = min(apart, key=lambda time: (apart[time], time), default=0)
        same = bool(apart) and apart[nearest] < _SAME_POSE
        times.append(nearest if same else frame.start_us + TURN_US // 2)
    return np.array(times, np.int64)


def _ego(segment: Segment, times: Int64Array) -> tuple[Trajectory, Array]:
    """The ego trajectory, near the origin, and the offset taken off it.

    Its poses are those of the images, so that each image has its own; a frame without images gives
    the frame's.
    """
    known: dict[int, Array] = {}
    for frame, time in zip(segment.frames, times.tolist(), strict=True):
        known.update((image.time_us, image.pose) for image in frame.images.values())
        if not frame.images:
            known[time] = frame.pose
    sorted_times = np.array(sorted(known), np.int64)
    gaps = np.diff(sorted_times)
    if np.any(gaps > LONGEST_GAP_US):
        late = sorted_times[int(np.argmax(gaps)) + 1]
        frame = next(f for f in segment.frames if f.start_us + LONGEST_GAP_US > late)
        raise frame.place.inside("pose").error(
            f"comes {gaps.max() / 1e6:.1f} s after the one before", "use a segment without the gap"
        )
    poses = np.stack([known[time] for time in sorted_times.tolist()])
    offset: Array = poses[0, :3, 3].copy()
    poses[:, :3, 3] -= offset
    first, last = segment.frames[0].start_us, segment.frames[-1].start_us + TURN_US
    return motion.extended(Trajectory(sorted_times, poses), first, last), offset
