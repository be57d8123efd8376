"""Boxes of a py123d scene to tracks in the world."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np

from recast.errors import InputError
from recast.logs import checks
from recast.logs.importers.py123d_sensors import matrix
from recast.logs.types import Array, Track, Trajectory

CATEGORIES = {
    "VEHICLE": "car",
    "TRAIN": "tram",
    "TWO_WHEELER": "cyclist",
    "PERSON": "pedestrian",
    "ANIMAL": "misc",
    "TRAFFIC_SIGN": "misc",
    "TRAFFIC_CONE": "misc",
    "TRAFFIC_LIGHT": "misc",
    "BARRIER": "misc",
    "GENERIC_OBJECT": "misc",
    "OTHER": "misc",
}
"""By py123d's common labels."""
WORDS = {"BUS": "bus", "TRUCK": "truck", "TRAILER": "truck", "LARGE": "truck", "VAN": "van"}
"""Words of a dataset's own label that tell more about a vehicle."""
RIDERS = {"CYCLIST", "BICYCLIST", "MOTORCYCLIST", "RIDER"}
"""Words of a dataset's own label of a person who is part of a two-wheeler."""
EGO = "EGO"


def read_tracks(
    scene: Any, folder: Path, trajectory: Trajectory, offset: Array
) -> dict[str, Track]:
    """Tracks by py123d's track token; the ego's own box is left out.

    Raises:
        InputError: a label is unknown, a box has no size or comes twice at a time.
    """
    found: dict[str, list[tuple[int, Any]]] = {}
    for stamp in scene.get_all_box_detections_se3_timestamps():
        time = int(stamp.time_us)
        boxes = scene.get_box_detections_se3_at_timestamp(time)
        if boxes is None or not trajectory.covers(time):
            continue
        for box in boxes:
            if box.attributes.default_label.name == EGO:
                continue
            rows = found.setdefault(str(box.attributes.track_token), [])
            if rows and rows[-1][0] == time:
                where = f"box {box.attributes.track_token} at {time} us"
                raise InputError(folder, where, "is there twice", "convert the log again")
            rows.append((time, box))
    return {token: _track(folder, token, rows, offset) for token, rows in found.items()}


def _track(folder: Path, token: str, rows: list[tuple[int, Any]], offset: Array) -> Track:
    boxes = [box.bounding_box_se3 for _, box in rows]
    sizes = np.array([[box.length, box.width, box.height] for box in boxes], np.float64)
    poses = np.stack([matrix(box.center_se3) for box in boxes])
    if not np.isfinite(poses).all() or not checks.are_box_sides(sizes).all():
        problem = "holds a box without a place or without a size"
        raise InputError(folder, f"track {token}", problem, "convert the log again")
    poses[:, :3, 3] -= offset
    attributes = rows[0][1].attributes
    kind = category(attributes.label.name, attributes.default_label.name)
    if kind is None:
        problem = f"has the label {attributes.default_label.name}, which is not known"
        raise InputError(folder, f"track {token}", problem, f"use one of {', '.join(CATEGORIES)}")
    times = np.array([time for time, _ in rows], np.int64)
    return Track(token, kind, np.median(sizes, axis=0), Trajectory(times, poses))


def category(label: str, common: str) -> str | None:
    """Our category of a dataset's own label and py123d's common one; None where unknown."""
    words = label.upper().split("_")
    if common == "VEHICLE":
        return next((WORDS[word] for word in words if word in WORDS), CATEGORIES[common])
    if common == "PERSON" and RIDERS.intersection(words):
        return "cyclist"
    return CATEGORIES.get(common)
