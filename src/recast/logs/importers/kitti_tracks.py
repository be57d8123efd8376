"""KITTI labels to tracks in the world.

Boxes were drawn on sweeps as recorded, smeared by the ego motion of the turn. So a box of frame i
holds, like the points in it, at the moment at which the scanner pointed there in turn i.
"""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path

import numpy as np

from recast.errors import InputError
from recast.geometry import se3
from recast.logs import motion
from recast.logs.importers.kitti_calibration import KittiCalibration
from recast.logs.importers.kitti_labels import (
    LabelledTrack,
    read_tracking_labels,
    read_tracklets,
)
from recast.logs.importers.kitti_velodyne import firing_times
from recast.logs.types import Int64Array, Track, Trajectory


def read_labels(path: Path, frame_count: int) -> list[LabelledTrack]:
    """Read tracklet_labels.xml or a tracking label file (any other suffix).

    Raises:
        InputError: missing or malformed, or a frame is beyond the drive's `frame_count`.
    """
    tracks = read_tracklets(path) if path.suffix == ".xml" else read_tracking_labels(path)
    for track in tracks:
        if track.frames[-1] >= frame_count:
            raise InputError(
                path,
                f"track {track.track_id}",
                f"frame {track.frames[-1]}, but the drive has {frame_count} frames",
                "name the label file of this drive",
            )
    return tracks


def place_tracks(
    labelled: Sequence[LabelledTrack],
    path: Path,
    turns: tuple[Int64Array, Int64Array, Int64Array],
    calibration: KittiCalibration,
    trajectory: Trajectory,
) -> dict[str, Track]:
    """Tracks by id, as far as the ego trajectory goes.

    Args:
        path: the label file, which tells the frame the boxes are given in.
        turns: trigger, start and end times of all turns of the drive.
    """
    trigger, start, end = turns
    is_tracklets = path.suffix == ".xml"
    rig_from_sensor = (
        calibration.rig_from_velodyne if is_tracklets else calibration.rig_from_rectified
    )
    velodyne_from_rig = se3.inverse(calibration.rig_from_velodyne)
    tracks = {}
    for track in labelled:
        frames = track.frames
        rig_from_box = rig_from_sensor @ track.sensor_from_box
        centres = se3.apply(velodyne_from_rig, rig_from_box[:, :3, 3])
        times = firing_times(centres, trigger[frames], start[frames], end[frames])
        first, last = trajectory.timestamps_us[[0, -1]]
        kept = (first <= times) & (times <= last)
        # Behind the car one turn ends and the next begins: a box there can be met twice at once.
        kept[1:] &= np.diff(times) > 0
        if not np.any(kept):
            continue
        poses = trajectory.at(times[kept]) @ rig_from_box[kept]
        # A labelled frame counts as the whole turn: its image may come before the scanner did.
        turn = max(start[frames[0]], first), min(end[frames[-1]], last)
        boxes = motion.extended(Trajectory(times[kept], poses), *turn)
        tracks[track.track_id] = Track(track.track_id, track.category, track.size, boxes)
    return tracks
