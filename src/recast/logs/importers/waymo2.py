"""Waymo Open Dataset v2: a segment's parquet tables as a driving log.

Source: Sun et al., "Scalability in Perception for Autonomous Driving: Waymo Open Dataset" (CVPR
2020), and the columns of the dataset's version 2.0. It holds what v1 holds but the map.
"""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path

from recast.errors import InputError
from recast.logs.importers.valid import returns_valid
from recast.logs.importers.waymo2_files import find_segment
from recast.logs.importers.waymo2_segment import read_segment
from recast.logs.importers.waymo_drive import driving_log
from recast.logs.types import DrivingLog


@returns_valid
def load_waymo2(
    root: Path, drive: str, labels: Path | None = None, cameras: Sequence[str] = ()
) -> DrivingLog:
    """Read a segment; images and sweeps are decoded when asked for. Version 2 has no map.

    Args:
        root: folder that holds the components (`vehicle_pose` and so on), or the splits.
        drive: the segment's name.
        labels: must be None, since a segment holds its own.
        cameras: names of the cameras to read, such as FRONT; all if empty.

    Raises:
        InputError: files are missing, damaged or do not belong together.
    """
    if labels is not None:
        raise InputError(labels, "labels", "a segment holds its own", "leave the option out")
    segment = read_segment(find_segment(Path(root), drive))
    return driving_log(segment, "Waymo Open Dataset v2", cameras)
