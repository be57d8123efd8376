"""Files of LiDAR points as rows of float32, as nuScenes and DriveStudio have them."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from recast.errors import InputError
from recast.logs import checks
from recast.storage import read_bytes

_LARGEST = 1 << 28
"""Bytes of a sweep."""


def read_points(path: Path, width: int, used: Sequence[int], mend: str) -> NDArray[np.float32]:
    """Rows (N >= 1, width) of a file.

    Args:
        used: columns that must be finite, and within what a log may hold.
        mend: what the user can do about any fault.

    Raises:
        InputError: the file is missing, empty, cut off or too large, or a value is out of range.
    """
    data = read_bytes(path, _LARGEST)
    if not data or len(data) % (4 * width):
        problem = f"{len(data)} bytes are not a whole number of {4 * width}-byte points"
        raise InputError(path, "points", problem, mend)
    rows = np.frombuffer(data, "<f4").reshape(-1, width)
    wrong = ~(np.abs(rows[:, used]) <= checks.SENSOR_REACH)  # also NaN
    if wrong.any():
        point = int(np.argmax(wrong.any(axis=1)))
        value = rows[point, used][wrong[point]][0]
        problem = f"is NaN or infinite, or not within {checks.SENSOR_REACH:g} m ({value:g})"
        raise InputError(path, f"point {point}", problem, mend)
    return rows
