"""Waymo Open Dataset v1: a segment's cameras, LiDARs, labels and map into a log folder.

Source: Sun et al., "Scalability in Perception for Autonomous Driving: Waymo Open Dataset" (CVPR
2020), and the proto files of the dataset. Neither TensorFlow nor a protocol buffer library is
needed. Scenarios of the motion dataset are read too: tracks and map, no sensors.
"""

from __future__ import annotations

from pathlib import Path

import numpy as np

from recast.errors import InputError
from recast.geometry import se3
from recast.logs import motion
from recast.logs.importers.waymo_cameras import read_cameras, shutter_notes
from recast.logs.importers.waymo_files import find_drive, is_motion
from recast.logs.importers.waymo_frames import read_segment
from recast.logs.importers.waymo_labels import read_tracks
from recast.logs.importers.waymo_lidar import read_lidars
from recast.logs.importers.waymo_map import read_map
from recast.logs.importers.waymo_motion import load_scenario
from recast.logs.importers.waymo_range_image import TURN_US
from recast.logs.importers.waymo_segment import Segment
from recast.logs.store import write_log
from recast.logs.types import Array, DrivingLog, Int64Array, Trajectory

LICENCE = "Waymo Dataset License Agreement for Non-Commercial Use"
LONGEST_GAP_US = 1_000_000
_SAME_POSE = 1e-3
"""Metres (and radians) within which a camera's pose is the frame's own."""


def import_waymo(root: Path, drive: str, out: Path, labels: Path | None = None) -> None:
    """Import one segment, with its map where it has one, into the new log folder `out`.

    Args:
        root: folder that holds the TFRecord files, itself or one level below.
        drive: the segment's file or name; of the motion dataset FILE:SCENARIO, or FILE where it
            holds one scenario.
        out: log folder to write; it appears whole or not at all.
        labels: not known for this dataset.

    Raises:
        InputError: the file is missing or damaged, or fields are missing or unknown; nothing is
            written then.
    """
    if labels is not None:
        raise InputError(labels, "labels", "a segment holds its own", "leave the option out")
    if Path(out).exists():
        raise InputError(out, "output folder", "exists already", "name another one or remove it")
    write_log(load_waymo(root, drive), out)


def load_waymo(root: Path, drive: str) -> DrivingLog:
    """Read a segment or scenario; images and sweeps stay in its file until asked for.

    Raises:
        InputError: see `import_waymo`.
    """
    path, scenario = find_drive(Path(root), drive)
    if scenario is not None or is_motion(path):
        return load_scenario(path, scenario, LICENCE)
    segment = read_segment(path)
    times = _frame_times(segment)
    trajectory, offset = _ego(segment, times)
    name = segment.context["name"]
    context = segment.context.get("stats")
    world_from_global = se3.from_rotation_translation(np.eye(3), -offset)
    return DrivingLog(
        name=name,
        cameras=read_cameras(segment),
        lidars=read_lidars(segment, times, world_from_global, trajectory),
        world_from_rig=trajectory,
        tracks=read_tracks(segment, world_from_global),
        map=read_map(segment, world_from_global, trajectory.poses[:, :2, 3]),
        world_offset=offset,
        metadata={
            "dataset": "Waymo Open Dataset v1",
            "drive": name,
            "licence": LICENCE,
            **({} if context is None else {k: str(v) for k, v in context.values.items()}),
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
        raise InputError(
            segment.path,
            f"record {frame.record}, pose",
            f"comes {gaps.max() / 1e6:.1f} s after the one before",
            "use a segment without the gap",
        )
    poses = np.stack([known[time] for time in sorted_times.tolist()])
    offset: Array = poses[0, :3, 3].copy()
    poses[:, :3, 3] -= offset
    first, last = segment.frames[0].start_us, segment.frames[-1].start_us + TURN_US
    return motion.extended(Trajectory(sorted_times, poses), first, last), offset
