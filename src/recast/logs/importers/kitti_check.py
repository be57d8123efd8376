"""Do these labels belong to this drive? LiDAR points inside the boxes tell."""

from __future__ import annotations

from collections.abc import Mapping
from pathlib import Path

import numpy as np

from recast.errors import InputError
from recast.geometry import boxes, se3
from recast.logs.types import DrivingLog, Track

RANGE = 25.0  # metres; farther boxes can be empty, hidden behind others
MIN_POINTS = 5
MIN_BOXES = 5
MIN_FRACTION = 0.5  # right drives have 0.9 and more, wrong ones below 0.2
MARGIN = 0.1
ABOVE_ROAD = 0.25  # metres of a box's foot left out: any box on the road holds road points


def check_labels_fit(log: DrivingLog, tracks: Mapping[str, Track], path: Path) -> None:
    """Check that the boxes near the car hold LiDAR points.

    With fewer than five boxes to judge by, nothing is said.

    Raises:
        InputError: most boxes are empty: the labels belong to another drive.
    """
    tested = filled = 0
    for lidar in log.lidars.values():
        for index, time in enumerate(lidar.timestamps_us.tolist()):
            rig_from_world = se3.inverse(log.world_from_rig.at(time))
            near = [
                (track, rig_from_world @ track.trajectory.at(time))
                for track in tracks.values()
                if time in track.trajectory.timestamps_us
            ]
            near = [(t, pose) for t, pose in near if np.hypot(*pose[:2, 3]) < RANGE]
            if not near:
                continue
            points = lidar.sweeps[index].points
            for track, rig_from_box in near:
                tested += 1
                filled += _points_above_road(points, track, rig_from_box) >= MIN_POINTS
    if tested >= MIN_BOXES and filled < MIN_FRACTION * tested:
        raise InputError(
            path,
            "boxes",
            f"{tested - filled} of {tested} boxes within {RANGE:.0f} m hold no LiDAR points: "
            "labels of another drive",
            "name the label file of this drive",
        )


def _points_above_road(points: np.ndarray, track: Track, rig_from_box: np.ndarray) -> int:
    raised = rig_from_box @ se3.from_rotation_translation(np.eye(3), [0, 0, ABOVE_ROAD / 2])
    size = track.size - [0.0, 0.0, ABOVE_ROAD + 2 * MARGIN]
    if size[2] <= 0:
        return len(points)
    return int(np.count_nonzero(boxes.contains(points, size, raised, MARGIN)))
