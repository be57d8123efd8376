"""Street Gaussians' track_info.txt: boxes in the vehicle frame into tracks."""

from __future__ import annotations

from pathlib import Path

import numpy as np

from recast.errors import InputError
from recast.geometry import se3
from recast.logs.importers.processed_folder import FARTHEST
from recast.logs.importers.street_gaussians_ego import Drive
from recast.logs.types import Array, Track, Trajectory

CATEGORIES = {"vehicle": "car", "pedestrian": "pedestrian", "cyclist": "cyclist"}
LEFT_OUT = ("sign", "misc")
_COLUMNS = (11, 12)  # frame track class alpha h w l cx cy cz heading [speed]
_MEND = "process the scene again"


def read_tracks(path: Path, drive: Drive) -> dict[str, Track]:
    """Tracks by the file's own numbers, each box placed with its frame's vehicle pose.

    Raises:
        InputError: the file is missing, a line has too few or wrong values, an unknown class or
            frame, a box comes twice, or is not in the vehicle's frame.
    """
    if not path.is_file():
        raise InputError(path, "file", "is missing", "name another with --labels")
    lines = path.read_text(errors="replace").splitlines()
    grouped: dict[str, dict[int, tuple[str, Array, Array]]] = {}
    for number, line in enumerate(lines[1:], start=2):  # the first names the columns
        words = line.split()
        if not words:
            continue
        frame, category, size, pose = _box(path, f"line {number}", words, drive)
        if category in LEFT_OUT:
            continue
        track = grouped.setdefault(words[1], {})
        if frame in track:
            problem = f"track {words[1]} is there twice in frame {frame}"
            raise InputError(path, f"line {number}: track", problem, "keep one of them")
        track[frame] = (CATEGORIES[category], size, pose)
    tracks = {}
    for name, boxes in grouped.items():
        frames = sorted(boxes)
        times = np.array([drive.frame_times[frame] for frame in frames], np.int64)
        poses = np.stack([drive.world_from_frame[frame] @ boxes[frame][2] for frame in frames])
        size = np.median([boxes[frame][1] for frame in frames], axis=0)
        tracks[name] = Track(name, boxes[frames[0]][0], size, Trajectory(times, poses))
    return tracks


def _box(path: Path, where: str, words: list[str], drive: Drive) -> tuple[int, str, Array, Array]:
    """Frame, class, size (length, width, height) and vehicle_from_box of a line."""
    if len(words) not in _COLUMNS:
        raise InputError(path, where, f"has {len(words)} columns, not 11 or 12", _MEND)
    category = words[2].lower()
    if category not in (*CATEGORIES, *LEFT_OUT):
        raise InputError(path, f"{where}: class", f"{words[2]!r} is unknown", _MEND)
    try:
        frame = int(words[0])
        height, width, length, x, y, z, heading = (float(word) for word in words[4:11])
    except ValueError:
        raise InputError(path, where, "holds words where numbers belong", _MEND) from None
    if frame not in drive.frame_times:
        problem = f"{frame} has no ego_pose/{frame:06d}.txt"
        raise InputError(path, f"{where}: frame", problem, "take the tracks of this scene")
    if not np.all(np.isfinite([height, width, length, x, y, z, heading])):
        raise InputError(path, where, "holds NaN or infinity", _MEND)
    if min(height, width, length) <= 0:
        raise InputError(path, f"{where}: size", "is not positive", "remove the box")
    if (distance := float(np.linalg.norm([x, y, z]))) > FARTHEST:
        problem = f"the box is {distance:.0f} m from the ego: not in the vehicle's frame"
        raise InputError(path, f"{where}: centre", problem, "give boxes in the vehicle frame")
    pose = se3.from_rotation_translation(se3.rotation_z(heading), [x, y, z])
    return frame, category, np.array([length, width, height]), pose
