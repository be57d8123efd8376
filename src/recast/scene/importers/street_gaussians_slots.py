"""Boxes of Street Gaussians' label file, and the slot each has in its frame."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

import numpy as np

from recast.errors import InputError
from recast.geometry import se3
from recast.logs import Trajectory
from recast.logs.importers.street_gaussians_boxes import CATEGORIES, read_box_rows
from recast.scene.dynamic import moves
from recast.scene.importers.placing import Array
from recast.storage import read_json

_MEND = "give the folder that the checkpoint was trained on"

Boxes = dict[int, dict[int, Array]]


def read_boxes(
    folder: Path, frames: Sequence[int], cameras: Sequence[int], poses: Mapping[int, Array]
) -> tuple[Boxes, dict[tuple[int, int], int], int]:
    """Boxes seen by the cameras, in the vehicle frame, and their slots.

    Args:
        folder: with track_info.txt and track_camera_vis.json.
        poses: (4, 4) ego poses by frame.

    Returns:
        x, y, z, heading by track number and frame; slots by track number and frame, of the tracks
        that move; slots a frame has.

    Raises:
        InputError: a file is missing or broken.
    """
    path = folder / "track_info.txt"
    seen_by = _visibility(folder / "track_camera_vis.json")
    boxes: Boxes = {}
    rows: list[tuple[int, int]] = []
    for row in read_box_rows(path, _MEND):
        if row.kind not in CATEGORIES or row.frame not in frames:
            continue
        try:
            track = int(row.track)
        except ValueError:
            problem = f"{row.track!r} is no number"
            raise InputError(path, f"{row.where}: track", problem, _MEND) from None
        if not seen_by.get((track, row.frame), frozenset()) & set(cameras):
            continue
        boxes.setdefault(track, {})[row.frame] = np.array([*row.centre, row.heading])
        rows.append((track, row.frame))
    moving = {track for track, own in boxes.items() if moves(_in_world(own, poses))}
    slots, count = assign_slots(rows, moving)
    return boxes, slots, count


def assign_slots(
    rows: Sequence[tuple[int, int]], moving: set[int]
) -> tuple[dict[tuple[int, int], int], int]:
    """Slots of (track, frame) rows, in the order of the file, and how many a frame has.

    Each row takes the first free slot of its frame; then tracks that stand still are taken out. If
    fewer slots suffice now, each frame is closed up in order, else the holes stay.
    """
    by_frame: dict[int, list[int]] = {}
    for track, frame in rows:
        by_frame.setdefault(frame, []).append(track)
    before = max(map(len, by_frame.values()), default=0)
    kept = {frame: [t for t in tracks if t in moving] for frame, tracks in by_frame.items()}
    after = max(map(len, kept.values()), default=0)
    places = kept if after < before else by_frame
    slots = {
        (track, frame): slot
        for frame, tracks in places.items()
        for slot, track in enumerate(tracks)
        if track in moving
    }
    return slots, after


def _in_world(boxes: Mapping[int, Array], poses: Mapping[int, Array]) -> Trajectory:
    frames = sorted(boxes)
    own = [se3.from_rotation_translation(np.eye(3), boxes[frame][:3]) for frame in frames]
    placed = [poses[frame] @ pose for frame, pose in zip(frames, own, strict=True)]
    return Trajectory(np.array(frames, np.int64), np.stack(placed))


def _visibility(path: Path) -> dict[tuple[int, int], frozenset[int]]:
    """Numbers of the cameras that see a track in a frame."""
    value: Any = read_json(path)
    try:
        return {
            (int(track), int(frame)): frozenset(int(camera) for camera in cameras)
            for track, frames in value.items()
            for frame, cameras in frames.items()
        }
    except (AttributeError, TypeError, ValueError, OverflowError) as error:
        raise InputError(
            path, "JSON", f"is no table of cameras by track and frame ({error})", _MEND
        ) from None
