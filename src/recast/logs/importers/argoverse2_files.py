"""Where the files of one Argoverse 2 log lie, and their times."""

from __future__ import annotations

import glob
import re
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from recast.errors import InputError
from recast.logs import checks
from recast.logs.importers.drive_names import check_drive
from recast.logs.types import Int64Array

POSES = "city_SE3_egovehicle.feather"
_NANOSECONDS = re.compile(r"[0-9]{1,19}")
_LISTED = 5
"""Names of other logs in a message; a split has hundreds."""


def find_log(root: Path, drive: str) -> Path:
    """The folder of a log: in `root`, in a split below it, or `root` itself.

    Raises:
        InputError: the folder or the log does not exist.
    """
    if not root.is_dir():
        raise InputError(root, "Argoverse 2 folder", "does not exist", "check the path")
    check_drive(root, drive)
    for folder in (root / drive, *sorted(root.glob(f"*/{glob.escape(drive)}")), root):
        if folder.name == drive and folder.is_dir():
            return folder
    found = sorted(
        path.parent.name for path in (*root.glob(f"*/{POSES}"), *root.glob(f"*/*/{POSES}"))
    )
    shown = ", ".join(found[:_LISTED]) + (
        f" and {len(found) - _LISTED} more" if len(found) > _LISTED else ""
    )
    mend = f"choose one of {shown}" if found else "name the folder that holds train, val or test"
    raise InputError(root, f"drive {drive}", "does not exist", mend)


@dataclass(frozen=True)
class TimedFiles:
    """Frames of one sensor, named after their time.

    Attributes:
        timestamps_us: (F,) int64, strictly increasing.
        paths: F files.
    """

    timestamps_us: Int64Array
    paths: tuple[Path, ...]

    def within(self, first_us: int, last_us: int) -> TimedFiles:
        """Those with a time in [first_us, last_us]."""
        kept = np.flatnonzero((self.timestamps_us >= first_us) & (self.timestamps_us <= last_us))
        return TimedFiles(self.timestamps_us[kept], tuple(self.paths[i] for i in kept))


def list_frames(folder: Path, suffix: str) -> TimedFiles:
    """Frames `<nanoseconds><suffix>` in the order of time; none where there is no such folder.

    Raises:
        InputError: a name is no time, or two frames have the same microsecond.
    """
    paths = list(folder.glob(f"*{suffix}"))
    for path in sorted(paths):
        if not _NANOSECONDS.fullmatch(path.stem) or int(path.stem) >= 1000 * checks.LATEST_US:
            raise InputError(path, "file name", "is not a time in nanoseconds", "remove the file")
    paths.sort(key=lambda path: int(path.stem))
    times = np.array([int(path.stem) for path in paths], np.int64) // 1000
    same = np.flatnonzero(np.diff(times) <= 0)
    if len(same):
        raise InputError(
            paths[same[0] + 1],
            "file name",
            f"is less than a microsecond after {paths[same[0]].name}",
            "remove one of them",
        )
    return TimedFiles(times, tuple(paths))
