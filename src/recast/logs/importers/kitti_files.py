"""Files of one KITTI raw drive: names and timestamps."""

from __future__ import annotations

import re
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from recast import storage
from recast.errors import InputError
from recast.logs.types import Array, Int64Array

TEXT_LIMIT = 1 << 26
"""Bytes of a text file; labels of a long drive have 1 MB."""
_FRAME = re.compile(r"[0-9]{1,10}")
_TIME = re.compile(
    r"(19[7-9][0-9]|2[01][0-9]{2})-[0-9]{2}-[0-9]{2}[ T]"  # nanoseconds end in the year 2262
    r"[0-9]{2}:[0-9]{2}:[0-9]{2}(\.[0-9]{1,9})?"
)


@dataclass(frozen=True)
class KittiDrive:
    """Where one drive's files lie.

    Attributes:
        name: "2011_09_26_drive_0013".
        calibration: the day's folder with calib_*.txt.
        folder: the drive's folder with image_02, velodyne_points, oxts.
    """

    name: str
    calibration: Path
    folder: Path


def find_drive(root: Path, drive: str) -> KittiDrive:
    """Locate a synchronised drive under `root`.

    Raises:
        InputError: the folder or the drive does not exist.
    """
    if not root.is_dir():
        raise InputError(root, "KITTI folder", "does not exist", "check the path")
    name = drive.removesuffix("_sync")
    day = root / name[:10]
    folder = day / f"{name}_sync"
    if not folder.is_dir():
        found = sorted(path.name for path in root.glob("????_??_??/*_sync"))
        mend = f"choose one of {', '.join(found)}" if found else "name the folder above 2011_09_26"
        raise InputError(root, f"drive {drive}", "does not exist", mend)
    return KittiDrive(name, day, folder)


@dataclass(frozen=True)
class SensorFiles:
    """Frames of one sensor that exist on disk.

    Attributes:
        indices: (F,) frame numbers, ascending; gaps are normal.
        timestamps_us: (F,) int64.
        paths: F files.
    """

    indices: Int64Array
    timestamps_us: Int64Array
    paths: tuple[Path, ...]


def list_frames(sensor: Path, suffix: str) -> SensorFiles:
    """List the frames of one sensor folder and their times; timestamps.txt may list more.

    Raises:
        InputError: no frames, a frame without a timestamp, or timestamps out of order.
    """
    paths = sorted((sensor / "data").glob(f"*{suffix}"))
    if not paths:
        raise InputError(sensor / "data", f"*{suffix}", "no such files", "check the download")
    for path in paths:
        if not _FRAME.fullmatch(path.stem):
            raise InputError(path, "file name", "is not a frame number", "remove the file")
    paths.sort(key=lambda path: int(path.stem))
    indices = np.array([int(path.stem) for path in paths], np.int64)
    twice = np.flatnonzero(np.diff(indices) == 0)
    if len(twice):
        problem = f"is frame {indices[twice[0]]}, like {paths[twice[0] + 1].name}"
        raise InputError(paths[twice[0]], "file name", problem, "remove one of the two")
    times = read_timestamps(sensor / "timestamps.txt")
    if indices[-1] >= len(times):
        raise InputError(
            sensor / "timestamps.txt",
            f"line {indices[-1] + 1}",
            f"is missing, frame {paths[-1].name} has no timestamp",
            "download the file again",
        )
    chosen = times[indices]
    late = np.flatnonzero(np.diff(chosen) <= 0)
    if len(late):
        line, before = indices[late[0] + 1] + 1, indices[late[0]] + 1
        raise InputError(
            sensor / "timestamps.txt",
            f"line {line}",
            f"is not later than line {before}: timestamps out of order",
            "download the file again",
        )
    return SensorFiles(indices, chosen, tuple(paths))


def read_timestamps(path: Path) -> Int64Array:
    """Times (F,) int64 microseconds since 1970 of "2011-09-26 13:10:51.168593664" lines.

    Raises:
        InputError: the file is missing or a line is not a time.
    """
    times = []
    for number, line in enumerate(
        storage.read_text(path, TEXT_LIMIT).rstrip().split("\n"), start=1
    ):
        time = line.strip()
        try:
            if not _TIME.fullmatch(time):
                raise ValueError
            nanoseconds = np.datetime64(time.replace(" ", "T"), "ns").astype(np.int64)
        except ValueError:
            problem = f"{time!r} is not a time"
            raise InputError(path, f"line {number}", problem, "download it again") from None
        times.append(int(nanoseconds) // 1000)
    return np.array(times, np.int64)


def read_numbers(path: Path) -> Array:
    """All whitespace-separated numbers of a text file.

    Raises:
        InputError: missing, or something in it is not a number.
    """
    text = storage.read_text(path, TEXT_LIMIT)
    try:
        return np.array([float(word) for word in text.split()])
    except ValueError as error:
        problem = f"cannot be read ({error})"
        raise InputError(path, "numbers", problem, "download it again") from None
