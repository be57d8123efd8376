"""What importers have in common: checks of a drive's name, cameras, points, poses, map and log."""

from __future__ import annotations

import os
from collections.abc import Callable, Iterable, Mapping, Sequence
from functools import wraps
from pathlib import Path
from typing import Any, Concatenate, ParamSpec

import numpy as np
import shapely
from numpy.typing import NDArray
from pydantic import BaseModel, ConfigDict

from recast.arrays import BoolArray
from recast.core.errors import InputError
from recast.core.files import disk_errors, kind_of_file, read_bytes
from recast.geometry import se3
from recast.logs import checks
from recast.logs.hdmap import Lane
from recast.logs.plausibility import examined
from recast.logs.types import Array, DrivingLog, Int64Array

_NAME_BYTES = 240
"""Longest name of a drive: file systems take 255 bytes, with its suffix."""
LISTED = 5
"""Names of other drives in a message; a split has hundreds."""
IMAGES = (".jpg", ".jpeg", ".png")
"""Suffixes of image files, lower case."""
_SWEEP_BYTES = 1 << 28
"""Longest file of a sweep."""
FASTEST = 100.0
"""Metres a second that an ego may go between two poses, beside a metre of jitter."""
NEAR = 200.0
"""Metres that the ego may be beside the lanes' bounding box."""
Rest = ParamSpec("Rest")


class ForeignRecord(BaseModel):
    """Base of records in datasets' files: further members are not looked at, numbers are finite."""

    model_config = ConfigDict(extra="ignore", allow_inf_nan=False, frozen=True)


class Timed:
    """A sequence as long as its `timestamps_us`: base of sweeps and images that are read on
    demand."""

    timestamps_us: Int64Array

    def __len__(self) -> int:
        """Number of frames."""
        return len(self.timestamps_us)


def check_drive(root: Path, drive: str) -> None:
    """Check that a drive's name is one file name, which leads to nowhere else.

    Raises:
        InputError: it is empty, too long, or holds a slash or a NUL.
    """
    wrong = not drive or drive in (".", "..") or len(os.fsencode(drive)) > _NAME_BYTES
    if wrong or "/" in drive or "\\" in drive or "\0" in drive:
        raise InputError(
            root, "drive", f"{drive!r} is not a drive name", "give only the drive's name"
        )


def files_of(folder: Path, suffixes: Sequence[str]) -> list[Path]:
    """Files of a folder, sorted, whose suffix in lower case is one of these; none without it."""
    return sorted(path for path in folder.glob("*") if path.suffix.lower() in suffixes)


def words_of(text: str) -> list[str]:
    """Words of a text file; what follows # in a line is a comment."""
    return [word for line in text.splitlines() for word in line.partition("#")[0].split()]


def nearest_rotation(printed: Array) -> Array | None:
    """The rotation nearest to a finite matrix (3, 3) as it was printed, not quite orthogonal.

    None where that is more than a thousandth away in some entry.
    """
    rotation, off = se3.nearest_rotations(printed)
    return rotation if off <= 1e-3 else None


def unknown_drive(
    root: Path, drive: str, known: Iterable[str], otherwise: str, problem: str = "does not exist"
) -> InputError:
    """The error for a drive that is not there: it names some that are, or says `otherwise`."""
    names = sorted(known)
    more = f" and {len(names) - LISTED} more" if len(names) > LISTED else ""
    mend = f"choose one of {', '.join(names[:LISTED])}{more}" if names else otherwise
    return InputError(root, f"drive {drive}", problem, mend)


def lane_outline(left: Array, right: Array) -> Array:
    """The counter-clockwise outline (M, 2) of a lane between its boundaries (N, 2 or 3)."""
    outline = np.concatenate([right, left[::-1]])[:, :2]
    return outline if shapely.LinearRing(outline).is_ccw else outline[::-1]


def chosen_cameras(where: Path, there: Iterable[str], wanted: Sequence[str]) -> list[str]:
    """Names of the cameras to import, in the order in which they are there.

    Args:
        where: the drive, for messages.
        there: names of all cameras of the drive.
        wanted: names of the cameras to import; all if empty.

    Raises:
        InputError: a wanted camera is not there; the message lists the cameras that are.
    """
    names = list(there)
    for name in wanted:
        if name not in names:
            listed = ", ".join(names)
            mend = f"choose one of {listed}" if listed else "leave the option out"
            raise InputError(where, "cameras", f"has no camera {name!r}", mend)
    return [name for name in names if not wanted or name in wanted]


def are_returns(points: NDArray[np.floating], *origins: NDArray[np.floating]) -> BoolArray:
    """Which points (N, 3) a beam came back from: those that are finite and not at the scanner.

    Files keep a beam without a return as NaN or as 0 0 0, which may have been transformed from the
    scanner's frame to another since.

    Args:
        origins: places (3,) or (N, 3) of the scanner in the frame of the points, beside 0 0 0.
    """
    kept: BoolArray = np.isfinite(points).all(axis=1)
    for origin in (np.zeros(3, points.dtype), *origins):
        kept &= (np.abs(points - origin) > checks.NEAREST_RETURN).any(axis=1)
    return kept


def unit_intensity(values: NDArray[Any]) -> NDArray[np.float32]:
    """Intensities (N,) of `DrivingLog`, 0 to 1, of a file that has them as 0 to 255.

    Some tools have divided them already: fractions of which none is above 1 are taken as they are.
    """
    scaled = np.asarray(values, np.float32)
    if not (np.all(scaled <= 1) and np.any(scaled != np.trunc(scaled))):
        scaled = scaled / np.float32(255)
    return np.clip(scaled, 0.0, 1.0)


def read_points(
    path: Path, width: int, place: slice, used: Sequence[int], mend: str
) -> NDArray[np.float32]:
    """Rows (N, width) of a file of points: float32, as of nuScenes and DriveStudio.

    Rows without a return are left out, see `are_returns`.

    Args:
        place: columns of x, y, z.
        used: other columns that must be finite, and within what a log may hold.
        mend: what the user can do about any fault.

    Raises:
        InputError: the file is missing, empty, cut off or too large, or a value is out of range.
    """
    data = read_bytes(path, _SWEEP_BYTES)
    kind = kind_of_file(data)
    if kind or len(data) % (4 * width):
        problem = f"{len(data)} bytes are not a whole number of {4 * width}-byte points"
        problem += f": the file is {kind}" if kind else ""
        raise InputError(path, "points", problem, mend)
    rows = np.frombuffer(data, "<f4").reshape(-1, width)
    rows = rows[are_returns(rows[:, place])]
    used = [*range(*place.indices(width)), *used]
    wrong = ~(np.abs(rows[:, used]) <= checks.SENSOR_REACH)  # also NaN
    if wrong.any():
        point = int(np.argmax(wrong.any(axis=1)))
        value = rows[point, used][wrong[point]][0]
        problem = f"is NaN or infinite, or not within {checks.SENSOR_REACH:g} m ({value:g})"
        raise InputError(path, f"point {point}", problem, mend)
    return rows


def first_jump(timestamps_us: Int64Array, poses: Array) -> tuple[int, float] | None:
    """The first pose that is too far from the one before, and how far, in metres.

    Args:
        timestamps_us: (T,) int64, not decreasing.
        poses: (T, 4, 4).
    """
    passed = np.diff(timestamps_us) / 1e6
    moved = np.linalg.norm(np.diff(poses[:, :3, 3], axis=0), axis=1)
    wrong = np.flatnonzero(moved > 1.0 + FASTEST * passed)
    return (int(wrong[0]) + 1, float(moved[wrong[0]])) if len(wrong) else None


def metres_beside(lanes: Mapping[str, Lane], ego: Array) -> float:
    """How far the ego's places (T, 2) are beside the bounding box of all lanes, at the most."""
    points = np.concatenate([lane.polygon for lane in lanes.values()])
    beside = np.maximum(points.min(axis=0) - ego, ego - points.max(axis=0))
    return float(np.linalg.norm(np.maximum(beside, 0.0), axis=1).max())


def returns_valid(
    load: Callable[Concatenate[Path, Rest], DrivingLog],
) -> Callable[Concatenate[Path, Rest], DrivingLog]:
    """A decorator: the log is `examined`, and what the disk refuses below the first argument, the
    dataset's folder, is one line."""

    @wraps(load)
    def loaded(root: Path, /, *args: Rest.args, **options: Rest.kwargs) -> DrivingLog:
        with disk_errors(root):
            log = load(root, *args, **options)
        return examined(log, root)

    return loaded
