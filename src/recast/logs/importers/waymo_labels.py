"""Waymo laser labels to tracks in the world."""

from __future__ import annotations

import numpy as np

from recast.logs import motion
from recast.logs.importers.waymo_range_image import TURN_US, scan_times
from recast.logs.importers.waymo_segment import LabelEntry, Segment
from recast.logs.types import Array, Track, Trajectory

CATEGORIES = {
    "vehicle": "car",
    "pedestrian": "pedestrian",
    "cyclist": "cyclist",
    "sign": "misc",
    "unknown": "misc",
}
"""The dataset does not tell cars from trucks and buses."""
_NEXT_TURN_US = TURN_US // 2


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
                raise label.place.error(f"{label.label_id} is there twice")
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
