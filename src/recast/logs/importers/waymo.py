"""Waymo Open Dataset v1: a segment's cameras, LiDARs, labels and map as a driving log.

Source: Sun et al., "Scalability in Perception for Autonomous Driving: Waymo Open Dataset" (CVPR
2020), and the proto files of the dataset. Neither TensorFlow nor a protocol buffer library is
needed. Scenarios of the motion dataset are read too: tracks and map, no sensors.
"""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path

from recast.errors import InputError
from recast.logs.importers.cameras import chosen_cameras
from recast.logs.importers.valid import returns_valid
from recast.logs.importers.waymo_drive import driving_log
from recast.logs.importers.waymo_files import find_drive, is_motion
from recast.logs.importers.waymo_frames import read_segment
from recast.logs.importers.waymo_motion import load_scenario
from recast.logs.importers.waymo_schema import LICENCE
from recast.logs.types import DrivingLog


@returns_valid
def load_waymo(
    root: Path, drive: str, labels: Path | None = None, cameras: Sequence[str] = ()
) -> DrivingLog:
    """Read a segment or scenario, with its map; images and sweeps are decoded when asked for.

    Args:
        root: folder that holds the TFRecord files, itself or one level below.
        drive: the segment's file or name; of the motion dataset FILE:SCENARIO, or FILE if it
            holds one scenario.
        labels: must be None, since a segment holds its own.
        cameras: names of the cameras to read, such as FRONT; all if empty.

    Raises:
        InputError: the file is missing or damaged, or fields are missing or unknown.
    """
    if labels is not None:
        raise InputError(labels, "labels", "a segment holds its own", "leave the option out")
    path, scenario = find_drive(Path(root), drive)
    if scenario is not None or is_motion(path):
        chosen_cameras(path, (), cameras)
        return load_scenario(path, scenario, LICENCE)
    return driving_log(read_segment(path), "Waymo Open Dataset v1", cameras)
