"""Argoverse 2 boxes: annotations.feather into tracks."""

from __future__ import annotations

from pathlib import Path

import numpy as np

from recast.core.errors import InputError
from recast.logs import checks, motion
from recast.logs.importers.argoverse2_files import (
    POSE,
    TIME,
    TURN_US,
    Columns,
    poses,
    read_columns,
    times_of,
)
from recast.logs.types import Array, Int64Array, Track, Trajectory

SIZE = ("length_m", "width_m", "height_m")
EGO = "EGO_VEHICLE"
CATEGORIES = {
    "REGULAR_VEHICLE": "car",
    "LARGE_VEHICLE": "truck",
    "BOX_TRUCK": "truck",
    "TRUCK": "truck",
    "TRUCK_CAB": "truck",
    "VEHICULAR_TRAILER": "truck",
    "BUS": "bus",
    "ARTICULATED_BUS": "bus",
    "SCHOOL_BUS": "bus",
    "RAILED_VEHICLE": "tram",
    "PEDESTRIAN": "pedestrian",
    "OFFICIAL_SIGNALER": "pedestrian",
    "STROLLER": "pedestrian",
    "WHEELCHAIR": "pedestrian",
    "BICYCLE": "cyclist",
    "BICYCLIST": "cyclist",
    "MOTORCYCLE": "cyclist",
    "MOTORCYCLIST": "cyclist",
    "WHEELED_DEVICE": "cyclist",
    "WHEELED_RIDER": "cyclist",
    "ANIMAL": "misc",
    "DOG": "misc",
    "BOLLARD": "misc",
    "CONSTRUCTION_BARREL": "misc",
    "CONSTRUCTION_CONE": "misc",
    "MESSAGE_BOARD_TRAILER": "misc",
    "MOBILE_PEDESTRIAN_CROSSING_SIGN": "misc",
    "SIGN": "misc",
    "STOP_SIGN": "misc",
    "TRAFFIC_LIGHT_TRAILER": "misc",
}
"""The dataset's categories; the ego's own box, which some files hold, is left out."""

BOX_DELAY_US = 54_000
"""When a box holds after its sweep's time: in the middle of the turn.

Boxes enclose the points as scanned, and both scanners, half a turn apart, meet every object: on
average in the middle of the turn, whatever its direction. Measured on real logs: the points of
both scanners fall onto each other when moved to their own times; box faces then lie best after 50
to 60 ms; and the paths of boxes are smooth to 5 mm over a second, without the jumps that times by
direction would bring in.
"""
_FARTHEST = 500.0
"""Metres from the ego: boxes are in its frame, and no LiDAR sees farther."""


def read_tracks(path: Path, world_from_rig: Trajectory, rig_from_ego: Array) -> dict[str, Track]:
    """Tracks by id, each box placed with the ego pose of its own sweep.

    A box holds `BOX_DELAY_US` after its sweep's time. A labelled sweep counts as its whole turn:
    the first and last boxes are continued to its ends, as far as the ego trajectory goes.

    Raises:
        InputError: the file, a column or a value is wrong, a category is unknown, a box has a time
            without ego pose or comes twice, or boxes are not in the ego's frame.
    """
    rows = read_columns(path, (TIME, *SIZE, *POSE), ("track_uuid", "category"))
    ego_from_box = poses(path, rows)
    times = times_of(path, rows) // 1000
    size = np.stack([rows[name].astype(np.float64) for name in SIZE], axis=-1)
    _check(path, rows, times, size, ego_from_box, world_from_rig)
    placed = world_from_rig.at(times) @ rig_from_ego @ ego_from_box

    tracks = {}
    wanted = rows["category"] != EGO
    for name in dict.fromkeys(rows["track_uuid"][wanted].tolist()):
        mine = np.flatnonzero(wanted & (rows["track_uuid"] == name))
        mine = mine[np.argsort(times[mine], kind="stable")]
        twice = np.flatnonzero(np.diff(times[mine]) <= 0)
        if len(twice):
            raise InputError(
                path,
                f"timestamp_ns in row {mine[twice[0] + 1]}",
                f"is there twice for track {name}",
                "keep one box for each track and time",
            )
        category = CATEGORIES[str(rows["category"][mine[0]])]
        trajectory = _whole_turns(times[mine], placed[mine], world_from_rig)
        if trajectory is not None:
            tracks[name] = Track(name, category, np.median(size[mine], axis=0), trajectory)
    return tracks


def _whole_turns(sweeps_us: Int64Array, boxes: Array, ego: Trajectory) -> Trajectory | None:
    """The path of boxes (N, 4, 4) of sweeps (N,); None where no ego pose is late enough."""
    times = sweeps_us + BOX_DELAY_US
    last = int(ego.timestamps_us[-1])
    kept = times <= last
    if not np.any(kept):
        return None
    path = Trajectory(times[kept], boxes[kept])
    return motion.extended(path, int(sweeps_us[0]), min(int(sweeps_us[kept][-1]) + TURN_US, last))


def _check(
    path: Path,
    rows: Columns,
    times: Int64Array,
    size: Array,
    ego_from_box: Array,
    world_from_rig: Trajectory,
) -> None:
    known = np.isin(rows["category"], [*CATEGORIES, EGO])
    if not known.all():
        row = int(np.argmin(known))
        raise InputError(
            path,
            f"category in row {row}",
            f"{str(rows['category'][row])!r} is none of Argoverse 2",
            f"use one of {', '.join(CATEGORIES)}",
        )
    wrong = ~checks.are_box_sides(size)
    if wrong.any():
        row, axis = np.argwhere(wrong)[0]
        raise InputError(
            path, f"{SIZE[axis]} in row {row}", f"is {size[row, axis]:g} m", "remove the box"
        )
    first, last = world_from_rig.timestamps_us[[0, -1]]
    outside = np.flatnonzero((times < first) | (times > last))
    if len(outside):
        raise InputError(
            path,
            f"timestamp_ns in row {outside[0]}",
            f"{rows['timestamp_ns'][outside[0]]} lies outside the log's ego poses",
            "take the annotations of this log",
        )
    distance = np.linalg.norm(ego_from_box[:, :3, 3], axis=1)
    if np.any(distance > _FARTHEST):
        row = int(np.argmax(distance > _FARTHEST))
        raise InputError(
            path,
            f"tx_m, ty_m, tz_m in row {row}",
            f"the box is {distance[row]:.0f} m from the ego, so it is not in the ego's frame",
            "give boxes in the ego frame of their sweep",
        )
