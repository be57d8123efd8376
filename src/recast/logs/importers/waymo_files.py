"""Where a Waymo segment or scenario lies."""

from __future__ import annotations

import glob
from pathlib import Path

from recast.errors import InputError
from recast.logs.importers.drive_names import check_drive
from recast.logs.importers.waymo_segment import record_errors
from recast.logs.importers.waymo_tfrecord import read_records
from recast.logs.importers.waymo_wire import BYTES, fields

_LISTED = 5
"""Names of other files in a message; a split has hundreds."""


def find_drive(root: Path, drive: str) -> tuple[Path, str | None]:
    """The file of a drive, in `root` or one level below, and the scenario of FILE:SCENARIO.

    Raises:
        InputError: the folder or the file does not exist, or several files have the name.
    """
    if not root.is_dir():
        raise InputError(root, "Waymo folder", "does not exist", "check the path")
    name, colon, scenario = drive.partition(":")
    check_drive(root, name)
    known = glob.escape(name)
    patterns = [known, f"{known}.tfrecord", f"segment-{known}*.tfrecord", f"{known}_*.tfrecord"]
    for pattern in patterns:
        found = sorted(
            path for path in (*root.glob(pattern), *root.glob(f"*/{pattern}")) if path.is_file()
        )
        if len(found) > 1:
            listed = ", ".join(str(path.relative_to(root)) for path in found[:_LISTED])
            raise InputError(root, f"drive {name}", f"may be {listed}", "name the folder of one")
        if found:
            return found[0], scenario if colon else None
    others = sorted(path.name for path in (*root.glob("*.tfrecord*"), *root.glob("*/*.tfrecord*")))
    shown = ", ".join(others[:_LISTED])
    if len(others) > _LISTED:
        shown += f" and {len(others) - _LISTED} more"
    mend = f"choose one of {shown}" if others else "name the folder that holds the TFRecord files"
    raise InputError(root, f"drive {name}", "does not exist", mend)


def is_motion(path: Path) -> bool:
    """Whether a file holds scenarios of the motion dataset, and not frames.

    Field 2 of a frame is its time, of a scenario a track.

    Raises:
        InputError: the first record is damaged or is no protocol buffer.
    """
    record = next(read_records(path))
    with record_errors(path, record.number):
        for number, wire, _ in fields(record.data, 0, len(record.data), "message"):
            if number == 2:
                return wire == BYTES
    return False
