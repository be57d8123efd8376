"""Do these labels belong to this drive? LiDAR points inside the boxes tell."""

from __future__ import annotations

from collections.abc import Mapping
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from recast.errors import InputError
from recast.logs.track_points import all_track_points
from recast.logs.types import DrivingLog, Int64Array, Track

RANGE = 40.0  # metres; farther boxes can be empty, hidden behind others
SWEEP_US = 60_000  # a label and its sweep are less than half a turn apart
MIN_POINTS = 5
MIN_BOXES = 5
MIN_FRACTION = (
    0.5  # right labels fill nearly all; shifted, reversed or mirrored ones a third or less
)


def check_labels_fit(log: DrivingLog, tracks: Mapping[str, Track], path: Path) -> None:
    """Check that the boxes near the car hold LiDAR points.

    With fewer than five boxes to judge by, nothing is said.

    Raises:
        InputError: most boxes are empty: the labels belong to another drive.
    """
    times = np.concatenate([lidar.timestamps_us for lidar in log.lidars.values()])
    tested = filled = 0
    for name, points in all_track_points(log, tracks, margin=0.1, clearance=0.25).items():
        near = _near_sweeps(log, tracks[name], times)
        counts = np.bincount(points.sweep, minlength=len(times))
        tested += len(near)
        filled += int(np.count_nonzero(counts[near] >= MIN_POINTS))
    if tested >= MIN_BOXES and filled < MIN_FRACTION * tested:
        raise InputError(
            path,
            "boxes",
            f"{tested - filled} of {tested} boxes within {RANGE:.0f} m hold no LiDAR points: "
            "labels of another drive",
            "name the label file of this drive",
        )


def _near_sweeps(log: DrivingLog, track: Track, times: Int64Array) -> NDArray[np.intp]:
    """Indices of the sweeps in which the object is labelled and near."""
    gaps = np.abs(track.trajectory.timestamps_us[:, None] - times)
    boxes, sweeps = np.nonzero(gaps < SWEEP_US)
    places = track.trajectory.poses[boxes, :2, 3]
    ego = log.world_from_rig.at(times[sweeps])[:, :2, 3]
    return np.unique(sweeps[np.linalg.norm(places - ego, axis=1) < RANGE])
