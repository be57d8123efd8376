"""Scenarios of the Waymo Open Motion Dataset: the recorded tracks and the map, no sensors."""

from __future__ import annotations

from pathlib import Path

import numpy as np

from recast.core.errors import InputError
from recast.geometry import se3
from recast.logs import checks
from recast.logs.importers.common import LISTED
from recast.logs.importers.waymo_map import decode_features, hd_map
from recast.logs.importers.waymo_proto import FieldError, Message, decode
from recast.logs.importers.waymo_segment import record_errors
from recast.logs.importers.waymo_tfrecord import TfRecord, read_records
from recast.logs.types import Array, DrivingLog, Int64Array, Track, Trajectory

CATEGORIES = {
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
    """Read one scenario: `scenario`, or the only one in the file.

    Raises:
        InputError: the file is damaged, holds no such scenario or several, or fields are missing
            or unknown.
    """
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
        ego, offset = _ego(message, times)
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


def _ego(message: Message, times: Int64Array) -> tuple[Trajectory, Array]:
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
        category = CATEGORIES[track.get("object_type", "unset")]
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
