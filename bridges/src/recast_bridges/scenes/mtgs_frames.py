"""Frames that an MTGS scene was trained on (`video_scene_dict.pkl`), a pickle read without running.

It is a table of drives, each with `frame_infos`: a list of tables with the time, the ego's pose in
the coordinates of the scene, cameras and boxes. Only what is used is looked at.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from pathlib import Path

import numpy as np

from recast.arrays import Array, Int64Array
from recast.core.errors import InputError
from recast.geometry import se3
from recast.logs import DrivingLog
from recast.logs.checks import LATEST_US, WORLD_REACH
from recast_bridges.scenes.checkpoint import CheckpointTable
from recast_bridges.scenes.pickled import read_pickle

FRAMES_FILE = "video_scene_dict.pkl"
_MEND = "name the checkpoint itself to import it without the recorded frames"


def read_drives(path: Path) -> dict[str, list[CheckpointTable]]:
    """The frames of each recorded drive, by the drive's token.

    Raises:
        InputError: the file is missing, is damaged or holds other things than plain values and
            arrays; no code in it is run. Or a drive has no list of frames.
    """
    content = read_pickle(path, _MEND)
    if not isinstance(content, Mapping):
        raise InputError(path, "pickle", f"holds {type(content).__name__}, not a table", _MEND)
    drives = content if "frame_infos" not in content else {"": content}
    found = {}
    for name, drive in drives.items():
        rows = drive.get("frame_infos") if isinstance(drive, Mapping) else None
        if not isinstance(rows, list):
            raise InputError(path, f"drive {name}", "has no list frame_infos", _MEND)
        for index, row in enumerate(rows):
            if not isinstance(row, Mapping):
                raise InputError(path, f"{name}.frame_infos[{index}]", "is not a table", _MEND)
        found[str(name)] = [
            CheckpointTable(path, row, f"{name}.frame_infos[{index}]")
            for index, row in enumerate(rows)
        ]
    return found


def read_places(frames: Sequence[CheckpointTable]) -> tuple[Int64Array, Array]:
    """Times (F,) in microseconds and places (F, 3) of the ego in the scene.

    Raises:
        InputError: a frame lacks its time or its place.
    """
    times, places = [], []
    for frame in frames:
        time = frame.number("timestamp")
        if not 0 <= time < LATEST_US:
            raise frame.fault("timestamp", f"is {time:g}, not microseconds", _MEND)
        name = "ego2global" if "ego2global" in frame else "ego2global_translation"
        place = frame.array(name)
        place = place[:3, 3] if place.shape == (4, 4) else place
        if place.shape != (3,) or not np.all(np.abs(place) <= WORLD_REACH):  # also NaN
            raise frame.fault(name, "is not a pose in metres", _MEND)
        times.append(round(time))
        places.append(place)
    return np.array(times, np.int64), np.array(places, np.float64).reshape(-1, 3)


def distance_to_log(
    times_us: Int64Array, places: Array, world_from_scene: Array, log: DrivingLog
) -> tuple[float, int]:
    """Median distance in metres, seen from above, of the two recordings of the ego's places.

    Args:
        times_us: (F,) times in microseconds.
        places: (F, 3) places of the ego in the scene.

    Returns:
        The distance, 0 if no time is in the log; and the number of frames whose times are.
    """
    first, last = log.world_from_rig.timestamps_us[[0, -1]]
    shared = (times_us >= first) & (times_us <= last)
    if not shared.any():
        return 0.0, 0
    there = se3.apply(world_from_scene, places[shared])
    gaps = there - log.world_from_rig.at(times_us[shared])[:, :3, 3]
    return float(np.median(np.linalg.norm(gaps[:, :2], axis=1))), int(shared.sum())
