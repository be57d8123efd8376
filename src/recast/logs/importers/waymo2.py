"""Waymo Open Dataset v2: a segment's parquet tables into a log folder.

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
from recast.logs.store import write_log
from recast.logs.types import DrivingLog
from recast.storage import require_new


def import_waymo2(
    root: Path,
    drive: str,
    out: Path,
    labels: Path | None = None,
    cameras: Sequence[str] = (),
) -> None:
    """Import one segment into the new log folder `out`; v2 has no map.

    Args:
        root: folder that holds the components (`vehicle_pose` and so on), or the splits.
        drive: the segment's name.
        out: log folder to write; it appears whole or not at all.
        labels: not known for this dataset.
        cameras: names of the cameras to import, such as FRONT; all if empty.

    Raises:
        InputError: files are missing, damaged or do not belong together; nothing is written then.
    """
    if labels is not None:
        raise InputError(labels, "labels", "a segment holds its own", "leave the option out")
    require_new(out)
    write_log(load_waymo2(root, drive, cameras), out)


@returns_valid
def load_waymo2(root: Path, drive: str, cameras: Sequence[str] = ()) -> DrivingLog:
    """Read a segment; images and sweeps stay in its files until asked for.

    Raises:
        InputError: see `import_waymo2`.
    """
    segment = read_segment(find_segment(Path(root), drive))
    return driving_log(segment, "Waymo Open Dataset v2", cameras)
