"""Checks of the values of a log, whatever wrote it; each raises ValueError that names its field.

The limits lie far beyond any drive, and within what float32 and float64 arithmetic bears.
"""

from __future__ import annotations

from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path

import numpy as np
from numpy.typing import ArrayLike, NDArray

from recast.core.errors import InputError

WORLD_REACH = 1e7
"""Metres: farthest coordinate of the world frame, a quarter of the way around the Earth."""
SENSOR_REACH = 1e5
"""Metres: farthest LiDAR point and sensor mounting in the rig frame."""
NEAREST_RETURN = 0.05
"""Metres around its origin within which no scanner measures: their datasheets say 0.1 m or more."""
BOX_SIDE = (1e-3, 1e3)
"""Metres: shortest and longest side of a labelled box, finest and coarsest cell of a grid."""
LATEST_US = 1 << 53
"""Microseconds since 1970 (the year 2255): later ones are not exact in float64 and in JSON."""
NAME_LIMIT = 1000
"""Characters of a name."""


@contextmanager
def refused(where: str | Path, mend: str) -> Iterator[None]:
    """Turn what a check raises inside the block into the one line that users see."""
    try:
        yield
    except InputError:
        raise
    except ValueError as error:
        field, separator, problem = str(error).partition(": ")
        if not separator:
            field, problem = "values", str(error)
        raise InputError(where, field, problem, mend) from error


def check_text(where: str, text: object) -> None:
    """Check for Unicode text that UTF-8 can hold."""
    if not isinstance(text, str):
        raise ValueError(f"{where}: expected text, got {type(text).__name__}")
    try:
        text.encode()
    except UnicodeEncodeError:
        raise ValueError(f"{where}: {text!r} contains a lone surrogate character") from None


def check_name(where: str, name: object) -> None:
    """Check for a name of 1 to `NAME_LIMIT` characters; any character is allowed."""
    check_text(where, name)
    if not isinstance(name, str) or not 0 < len(name) <= NAME_LIMIT:
        raise ValueError(f"{where}: a name must have 1 to {NAME_LIMIT} characters, got {name!r}")


def check_times(where: str, timestamps_us: NDArray[np.int64]) -> None:
    """Check for (T,) int64 that increase strictly, from 1970 on."""
    if timestamps_us.ndim != 1 or timestamps_us.dtype != np.int64:
        raise ValueError(
            f"{where}: expected (T,) int64, got {timestamps_us.shape} {timestamps_us.dtype}"
        )
    check_time_range(where, timestamps_us)
    if np.any(timestamps_us[1:] <= timestamps_us[:-1]):
        raise ValueError(f"{where}: must increase strictly")


def check_time_range(where: str, timestamps_us: NDArray[np.int64]) -> None:
    """Check that times (T,) in any order lie within [0, `LATEST_US`)."""
    odd = timestamps_us[(timestamps_us < 0) | (timestamps_us >= LATEST_US)]
    if len(odd):
        raise ValueError(f"{where}: {odd[0]} is not a time in microseconds since 1970")


def check_reach(where: str, values: NDArray[np.floating], reach: float) -> None:
    """Check that values (metres) are finite and at most `reach` from zero."""
    if not np.all(np.abs(values) <= reach):  # also NaN
        odd = values[~(np.abs(values) <= reach)].flat[0]
        raise ValueError(f"{where}: {odd:g} is not within {reach:g} m")


def are_box_sides(metres: ArrayLike) -> NDArray[np.bool_]:
    """Which of these lengths can be sides of a labelled box (see `BOX_SIDE`); NaN cannot."""
    metres = np.asarray(metres)
    shortest, longest = BOX_SIDE
    return (metres >= shortest) & (metres <= longest)


def check_poses(where: str, poses: NDArray[np.float64], reach: float) -> None:
    """Check for rigid transforms (..., 4, 4): proper rotations and translations within `reach`."""
    if poses.shape[-2:] != (4, 4):
        raise ValueError(f"{where}: expected (..., 4, 4), got {poses.shape}")
    check_reach(where, poses[..., :3, 3], reach)
    rotation = poses[..., :3, :3]
    check_reach(where, rotation, 2.0)  # no product below overflows
    if not np.allclose(rotation @ np.swapaxes(rotation, -1, -2), np.eye(3), atol=1e-5):
        raise ValueError(f"{where}: the upper left 3x3 block is not a rotation")
    if np.any(np.linalg.det(rotation) < 0):
        raise ValueError(f"{where}: the upper left 3x3 block is a mirror image of a rotation")
    if np.any(poses[..., 3, :] != [0.0, 0.0, 0.0, 1.0]):
        raise ValueError(f"{where}: the last row is not 0 0 0 1")


def check_lines(where: str, points: NDArray[np.float64], columns: int, least: int) -> None:
    """Check for finite points (N >= least, columns) of the world frame."""
    if points.ndim != 2 or points.shape[1] != columns or len(points) < least:
        raise ValueError(f"{where}: expected (N >= {least}, {columns}), got {points.shape}")
    check_reach(where, points, WORLD_REACH)
