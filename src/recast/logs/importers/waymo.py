"""Waymo Open Dataset v1: a segment's cameras, LiDARs, labels and map into a log folder.

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
from recast.logs.store import write_log
from recast.logs.types import DrivingLog
from recast.storage import require_new


def import_waymo(
    root: Path,
    drive: str,
    out: Path,
    labels: Path | None = None,
    cameras: Sequence[str] = (),
) -> None:
    """Import one segment, with its map where it has one, into the new log folder `out`.

    Args:
        root: folder that holds the TFRecord files, itself or one level below.
        drive: the segment's file or name; of the motion dataset FILE:SCENARIO, or FILE where it
            holds one scenario.
        out: log folder to write; it appears whole or not at all.
        labels: not known for this dataset.
        cameras: names of the cameras to import, such as FRONT; all if empty.

    Raises:
        InputError: the file is missing or damaged, or fields are missing or unknown; nothing is
            written then.
    """
    if labels is not None:
        raise InputError(labels, "labels", "a segment holds its own", "leave the option out")
    require_new(out)
    write_log(load_waymo(root, drive, cameras), out)


@returns_valid
def load_waymo(root: Path, drive: str, cameras: Sequence[str] = ()) -> DrivingLog:
    """Read a segment or scenario; images and sweeps stay in its file until asked for.

    Raises:
        InputError: see `import_waymo`.
    """
    path, scenario = find_drive(Path(root), drive)
    if scenario is not None or is_motion(path):
        chosen_cameras(path, (), cameras)
        return load_scenario(path, scenario, LICENCE)
    return driving_log(read_segment(path), "Waymo Open Dataset v1", cameras)
