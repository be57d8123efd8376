"""Tables of an Argoverse 2 log (Arrow feather files), checked as they are read."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from recast.errors import InputError
from recast.geometry import se3
from recast.logs import checks
from recast.logs.types import Array, Int64Array
from recast.tables import read_feather

QUATERNION = ("qw", "qx", "qy", "qz")
TRANSLATION = ("tx_m", "ty_m", "tz_m")
POSE = (*QUATERNION, *TRANSLATION)
TIME = "timestamp_ns"
_UNIT = 1e-3
_MEND = "download the log again"

Columns = dict[str, NDArray[Any]]


def read_columns(path: Path, numbers: Sequence[str], words: Sequence[str] = ()) -> Columns:
    """Columns (N,) of a feather file by name; others it may have are not looked at.

    Args:
        numbers: columns of integers or floats, all of which must be finite; kept as stored.
        words: columns of text.

    Raises:
        InputError: see `tables.read_feather` and `tables.Table`.
    """
    table = read_feather(path, [*numbers, *words], _MEND)
    return {
        **{name: table.numbers(name) for name in numbers},
        **{name: table.words(name) for name in words},
    }


def times_of(path: Path, columns: Columns) -> Int64Array:
    """Times (N,) of a table in nanoseconds.

    Raises:
        InputError: one is no integer, or lies outside of what a log can hold.
    """
    values = columns[TIME]
    latest = 1000 * checks.LATEST_US
    wrong = np.flatnonzero((values < 0) | (values >= latest) | (values != np.trunc(values)))
    if len(wrong):
        problem = f"{values[wrong[0]]} is no time in nanoseconds"
        raise InputError(path, f"{TIME} in row {wrong[0]}", problem, _MEND)
    return values.astype(np.int64)


def poses(path: Path, columns: Columns) -> Array:
    """Transforms (N, 4, 4) of the quaternions and translations of a table.

    Raises:
        InputError: a quaternion is not of unit length, or a translation is of no place on Earth.
    """
    quat = np.stack([columns[name].astype(np.float64) for name in QUATERNION], axis=-1)
    with np.errstate(over="ignore"):
        norm = np.linalg.norm(quat, axis=-1)
    wrong = np.flatnonzero(np.abs(norm - 1.0) > _UNIT)
    if len(wrong):
        raise InputError(
            path,
            f"qw, qx, qy, qz in row {wrong[0]}",
            f"are no rotation: the quaternion's length is {norm[wrong[0]]:.4g}, not 1",
            _MEND,
        )
    translation = np.stack([columns[name].astype(np.float64) for name in TRANSLATION], axis=-1)
    far = np.flatnonzero((np.abs(translation) > checks.WORLD_REACH).any(axis=-1))
    if len(far):
        problem = f"{translation[far[0]].tolist()} is not within {checks.WORLD_REACH:g} m"
        raise InputError(path, f"tx_m, ty_m, tz_m in row {far[0]}", problem, _MEND)
    return se3.from_rotation_translation(se3.quat_to_matrix(quat), translation)
