"""Boxes of Street Gaussians' track_info.txt into tracks."""

from __future__ import annotations

from pathlib import Path

import numpy as np

from recast.errors import InputError
from recast.geometry import se3
from recast.logs import checks
from recast.logs.importers.processed_folder import FARTHEST
from recast.logs.importers.street_gaussians_boxes import CATEGORIES, BoxRow, read_box_rows
from recast.logs.importers.street_gaussians_ego import Drive
from recast.logs.types import Array, Track, Trajectory

LEFT_OUT = ("sign", "misc")
_MEND = "process the scene again, or name another file with --labels"


def read_tracks(path: Path, drive: Drive) -> dict[str, Track]:
    """Tracks by the file's own numbers, each box placed with its frame's vehicle pose.

    Raises:
        InputError: the file is missing, a line has too few or wrong values, an unknown class or
            frame, a box comes twice, or is not in the vehicle's frame.
    """
    grouped: dict[str, dict[int, BoxRow]] = {}
    for row in read_box_rows(path, _MEND):
        _check(path, row, drive)
        if row.kind in LEFT_OUT:
            continue
        track = grouped.setdefault(row.track, {})
        if row.frame in track:
            problem = f"track {row.track} is there twice in frame {row.frame}"
            raise InputError(path, f"{row.where}: track", problem, "keep one of them")
        track[row.frame] = row
    tracks = {}
    for name, boxes in grouped.items():
        frames = sorted(boxes)
        times = np.array([drive.frame_times[frame] for frame in frames], np.int64)
        poses = [
            drive.world_from_frame[frame] @ _vehicle_from_box(boxes[frame]) for frame in frames
        ]
        size = np.median([boxes[frame].size for frame in frames], axis=0)
        category = CATEGORIES[boxes[frames[0]].kind]
        tracks[name] = Track(name, category, size, Trajectory(times, np.stack(poses)))
    return tracks


def _vehicle_from_box(row: BoxRow) -> Array:
    return se3.from_rotation_translation(se3.rotation_z(row.heading), row.centre)


def _check(path: Path, row: BoxRow, drive: Drive) -> None:
    if row.kind not in (*CATEGORIES, *LEFT_OUT):
        raise InputError(path, f"{row.where}: class", f"{row.kind!r} is unknown", _MEND)
    if row.frame not in drive.frame_times:
        problem = f"{row.frame} has no ego_pose/{row.frame:06d}.txt"
        raise InputError(path, f"{row.where}: frame", problem, "take the tracks of this scene")
    if not checks.are_box_sides(row.size).all():
        raise InputError(path, f"{row.where}: size", "is not a box's", "remove the box")
    if (distance := float(np.linalg.norm(row.centre))) > FARTHEST:
        problem = f"the box is {distance:.0f} m from the ego: not in the vehicle's frame"
        raise InputError(path, f"{row.where}: centre", problem, "give boxes in the vehicle frame")
