"""Waymo: segments of the Perception dataset, v1 and v2, and scenarios of the Motion dataset."""

from __future__ import annotations

import glob
from collections.abc import Sequence
from pathlib import Path

import numpy as np

from recast.core.errors import InputError
from recast.geometry import se3
from recast.logs import checks, motion
from recast.logs.importers import waymo2, waymo_tfrecord
from recast.logs.importers.common import (
    LISTED,
    check_drive,
    chosen_cameras,
    returns_valid,
    unknown_drive,
)
from recast.logs.importers.waymo2 import find_segment
from recast.logs.importers.waymo_proto import (
    LICENCE,
    FieldError,
    Message,
    decode,
    decode_features,
    hd_map,
)
from recast.logs.importers.waymo_segment import (
    TURN_US,
    LabelEntry,
    Segment,
    read_cameras,
    read_lidars,
    record_errors,
    scan_times,
    shutter_notes,
)
from recast.logs.importers.waymo_tfrecord import TfRecord, read_records
from recast.logs.types import Array, DrivingLog, Int64Array, Track, Trajectory

MOTION_CATEGORIES = {
    "vehicle": "car",
    "pedestrian": "pedestrian",
    "cyclist": "cyclist",
    "other": "misc",
    "unset": "misc",
}
CENTRE_AHEAD = 1.46
"""Metres from the rear axle to the middle of the ego's box, of a Chrysler Pacifica: the dataset
gives the box only."""


def load_scenario(path: Path, scenario: str | None, licence: str) -> DrivingLog:
    """Read one scenario: `scenario`, or the only one in the file. Raises InputError: the file is
    damaged, holds no such scenario or several, or fields are missing or unknown."""
    record = _choose(path, scenario)
    with record_errors(path, record.number):
        message = decode("Scenario", record.data)
        features = decode_features(message["map_features"])
        seconds = message["timestamps_seconds"]
        if not np.all((seconds >= 0) & (seconds < checks.LATEST_US / 1e6)):  # also NaN
            raise FieldError("timestamps_seconds", "are not all valid times")
        times = np.rint(seconds * 1e6).astype(np.int64)
        if len(times) < 2 or np.any(np.diff(times) <= 0):
            raise FieldError("timestamps_seconds", "must be two or more and increase")
        ego, offset = _scenario_ego(message, times)
        tracks = _tracks(message, times, ego, offset)
        map_of_scenario = hd_map(features, -offset, ego.poses[:, :2, 3]) if features else None
        name = message["scenario_id"]
    return DrivingLog(
        name=name,
        cameras={},
        lidars={},
        world_from_rig=ego,
        tracks=tracks,
        map=map_of_scenario,
        world_offset=offset,
        metadata={"dataset": "Waymo Open Motion Dataset", "drive": name, "licence": licence},
    )


def _choose(path: Path, scenario: str | None) -> TfRecord:
    chosen, names = None, []
    for record in read_records(path):
        with record_errors(path, record.number):
            names.append(decode("ScenarioHead", record.data)["scenario_id"])
        if scenario is None or names[-1] == scenario:
            chosen = chosen or record
    if scenario is None and len(names) > 1:
        problem = f"the file has {len(names)} scenarios"
    elif chosen is None:
        problem = f"{scenario} is not in the file"
    else:
        return chosen
    shown = ", ".join(names[:LISTED])
    raise InputError(
        path, "scenario_id", problem, f"name a scenario as FILE:SCENARIO, such as {shown}"
    )


def _scenario_ego(message: Message, times: Int64Array) -> tuple[Trajectory, Array]:
    """The rig on the ground, level, near the origin; and the offset taken off."""
    index = message["sdc_track_index"]
    if not 0 <= index < len(message["tracks"]):
        raise FieldError(
            "sdc_track_index", f"is {index}, but there are {len(message['tracks'])} tracks"
        )
    seen, poses, sizes = _states(message["tracks"][index], len(times))
    if np.count_nonzero(seen) < 2:
        raise FieldError(f"tracks[{index}].states", "fewer than two states of the ego are valid")
    box_from_rig = np.tile(np.eye(4), (len(sizes), 1, 1))
    box_from_rig[:, 0, 3] = -CENTRE_AHEAD
    box_from_rig[:, 2, 3] = -sizes[:, 2] / 2
    world_from_rig = poses @ box_from_rig
    offset: Array = world_from_rig[0, :3, 3].copy()
    world_from_rig[:, :3, 3] -= offset
    return Trajectory(times[seen], world_from_rig), offset


def _tracks(
    message: Message, times: Int64Array, ego: Trajectory, offset: Array
) -> dict[str, Track]:
    tracks: dict[str, Track] = {}
    within = (times >= ego.timestamps_us[0]) & (times <= ego.timestamps_us[-1])
    for i, track in enumerate(message["tracks"]):
        if i == message["sdc_track_index"]:
            continue
        seen, poses, sizes = _states(track, len(times))
        kept = within[seen]
        if not kept.any():
            continue
        poses[:, :3, 3] -= offset
        name = str(track["id"])
        if name in tracks:
            raise FieldError(track.path("id"), f"{name} appears twice")
        trajectory = Trajectory(times[seen][kept], poses[kept])
        category = MOTION_CATEGORIES[track.get("object_type", "unset")]
        tracks[name] = Track(name, category, np.median(sizes[kept], axis=0), trajectory)
    return tracks


def _states(track: Message, count: int) -> tuple[Array, Array, Array]:
    """Which states are valid (T,), and of those the poses (V, 4, 4) and sizes (V, 3)."""
    states = track["states"]
    if len(states) != count:
        raise FieldError(track.path("states"), f"there are {len(states)} for {count} timestamps")
    seen = np.array([bool(state.get("valid", 0)) for state in states])
    names = ("center_x", "center_y", "center_z", "heading", "length", "width", "height")
    rows = np.array(
        [[state[name] for name in names] for state in states if state.get("valid", 0)], np.float64
    ).reshape(-1, len(names))
    fits = checks.are_box_sides(rows[:, 4:]).all()
    if not fits or not np.all(np.abs(rows) <= checks.WORLD_REACH):  # also NaN
        raise FieldError(track.path("states"), "contain a box without a valid position or size")
    poses = se3.from_rotation_translation(se3.rotation_z(rows[:, 3]), rows[:, :3])
    return seen, poses, rows[:, 4:]


# Waymo Open Dataset: a segment's cameras, LiDARs, labels and map as a driving log.
#
# Source: Sun et al., "Scalability in Perception for Autonomous Driving: Waymo Open Dataset" (CVPR
# 2020), and the proto files of the dataset. Version 1 is read from its TFRecords, without
# TensorFlow, and so are scenarios of the motion dataset: tracks and map, no sensors. Version 2 is
# read from its parquet tables and holds the same, but for the map.

CATEGORIES = {
    "vehicle": "car",
    "pedestrian": "pedestrian",
    "cyclist": "cyclist",
    "sign": "misc",
    "unknown": "misc",
}
"""The dataset does not tell cars from trucks and buses."""
_NEXT_TURN_US = TURN_US // 2
LONGEST_GAP_US = 1_000_000
_SAME_POSE = 1e-3
"""Metres (and radians) within which a camera's pose is the frame's own."""


@returns_valid
def load_waymo(
    root: Path, drive: str, labels: Path | None = None, cameras: Sequence[str] = ()
) -> DrivingLog:
    """Read a segment or scenario, with its map; images and sweeps are decoded when asked for.

    Args:
        root: folder that holds the TFRecord files, itself or one level below.
        drive: the segment's file or name; of the motion dataset FILE:SCENARIO, or FILE if it
            holds one scenario.
        labels: must be None, since a segment holds its own.
        cameras: names of the cameras to read, such as FRONT; all if empty.

    Raises:
        InputError: the file is missing or damaged, or fields are missing or unknown.
    """
    if labels is not None:
        raise InputError(
            labels, "labels", "are already in the Waymo segment", "leave the option out"
        )
    path, scenario = find_drive(Path(root), drive)
    if scenario is not None or is_motion(path):
        chosen_cameras(path, (), cameras)
        return load_scenario(path, scenario, LICENCE)
    return driving_log(waymo_tfrecord.read_segment(path), "Waymo Open Dataset v1", cameras)


@returns_valid
def load_waymo2(
    root: Path, drive: str, labels: Path | None = None, cameras: Sequence[str] = ()
) -> DrivingLog:
    """Read a segment; images and sweeps are decoded when asked for. Version 2 has no map.

    Args:
        root: folder that holds the components (`vehicle_pose` and so on), or the splits.
        drive: the segment's name.
        labels: must be None, since a segment holds its own.
        cameras: names of the cameras to read, such as FRONT; all if empty.

    Raises:
        InputError: files are missing, damaged or do not belong together.
    """
    if labels is not None:
        raise InputError(
            labels, "labels", "are already in the Waymo segment", "leave the option out"
        )
    segment = waymo2.read_segment(find_segment(Path(root), drive))
    return driving_log(segment, "Waymo Open Dataset v2", cameras)


def find_drive(root: Path, drive: str) -> tuple[Path, str | None]:
    """The file of a drive, in `root` or one level below, and the scenario of FILE:SCENARIO. Raises
    InputError: the folder or the file does not exist, or several files have the name."""
    if not root.is_dir():
        raise InputError(root, "Waymo folder", "does not exist", "check the path")
    name, colon, scenario = drive.partition(":")
    check_drive(root, name)
    known = glob.escape(name)
    patterns = [known, f"{known}.tfrecord", f"segment-{known}*.tfrecord", f"{known}_*.tfrecord"]
    for pattern in patterns:
        found = sorted(
            path for path in (*root.glob(pattern), *root.glob(f"*/{pattern}")) if path.is_file()
        )
        if len(found) > 1:
            listed = ", ".join(str(path.relative_to(root)) for path in found[:LISTED])
            raise InputError(
                root, f"drive {name}", f"is ambiguous: {listed}", "name the folder of one of them"
            )
        if found:
            return found[0], scenario if colon else None
    others = (path.name for path in (*root.glob("*.tfrecord*"), *root.glob("*/*.tfrecord*")))
    otherwise = "name the folder that holds the TFRecord files"
    raise unknown_drive(root, name, others, otherwise)


def is_motion(path: Path) -> bool:
    """Whether a file holds scenarios of the motion dataset, and not frames.

    Field 2 of a scenario is a track, of a frame a number: its time.

    Raises:
        InputError: the first record is damaged or is no protocol buffer.
    """
    record = next(read_records(path))
    with record_errors(path, record.number):
        return bool(decode("ScenarioHead", record.data)["tracks"])


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
    hdmap, known = None, segment.map
    if known is not None:
        with known.place.errors():
            hdmap = hd_map(known.features, -offset - known.offset, trajectory.poses[:, :2, 3])
    return DrivingLog(
        name=segment.name,
        cameras={name: streams[name] for name in chosen},
        lidars=read_lidars(segment, times, world_from_global, trajectory),
        world_from_rig=trajectory,
        tracks=read_tracks(segment, world_from_global),
        map=hdmap,
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
            f"comes {gaps.max() / 1e6:.1f} s after the pose before", "use a segment without the gap"
        )
    poses = np.stack([known[time] for time in sorted_times.tolist()])
    offset: Array = poses[0, :3, 3].copy()
    poses[:, :3, 3] -= offset
    first, last = segment.frames[0].start_us, segment.frames[-1].start_us + TURN_US
    return motion.extended(Trajectory(sorted_times, poses), first, last), offset


def read_tracks(segment: Segment, world_from_global: Array) -> dict[str, Track]:
    """Tracks by id.

    Boxes are drawn on the points of a frame, which the TOP LiDAR scans one direction after the
    other while everything else moves on. So a box holds when the scanner pointed at it, as the
    image of the camera that looks there does. A labelled frame counts as its whole turn: the first
    and last boxes are continued to its ends, so that they cover the frame's images.

    Raises:
        InputError: a label comes twice in a frame.
    """
    found: dict[str, list[tuple[int, int, LabelEntry, Array]]] = {}
    for frame in segment.frames:
        world_from_vehicle = world_from_global @ frame.pose
        seen = set()
        for label in frame.labels:
            if label.label_id in seen:
                raise label.place.error(f"{label.label_id} appears twice")
            seen.add(label.label_id)
            x, y = label.vehicle_from_box[:2, 3]
            time = int(scan_times(np.arctan2(y, x), frame.start_us))
            row = (time, frame.start_us, label, world_from_vehicle @ label.vehicle_from_box)
            found.setdefault(label.label_id, []).append(row)
    return {name: _track(name, rows) for name, rows in found.items()}


def _track(name: str, rows: list[tuple[int, int, LabelEntry, Array]]) -> Track:
    # Behind the car one turn ends and the next begins: a box there can be met twice at once.
    kept = rows[:1]
    for row in rows[1:]:
        if row[0] - kept[-1][0] >= _NEXT_TURN_US:
            kept.append(row)
    times = np.array([time for time, *_ in kept], np.int64)
    poses = np.stack([pose for *_, pose in kept])
    turn = min(kept[0][1], int(times[0])), max(kept[-1][1] + TURN_US, int(times[-1]))
    trajectory = motion.extended(Trajectory(times, poses), *turn)
    size = np.median([label.size for _, _, label, _ in rows], axis=0)
    return Track(name, CATEGORIES[rows[0][2].category], size, trajectory)
