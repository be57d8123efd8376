"""Tables of an Argoverse 2 log (Arrow feather files), checked as they are read."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path
from typing import Any

import numpy as np
import pyarrow as pa
from numpy.typing import NDArray
from pyarrow import feather

from recast.errors import InputError
from recast.geometry import se3
from recast.logs.types import Array

QUATERNION = ("qw", "qx", "qy", "qz")
TRANSLATION = ("tx_m", "ty_m", "tz_m")
POSE = (*QUATERNION, *TRANSLATION)
_UNIT = 1e-3
_MEND = "download the log again"

Columns = dict[str, NDArray[Any]]


def read_columns(path: Path, numbers: Sequence[str], words: Sequence[str] = ()) -> Columns:
    """Columns (N,) of a feather file by name; others it may have are not looked at.

    Args:
        numbers: columns of integers or floats, all of which must be finite; kept as stored.
        words: columns of text.

    Raises:
        InputError: the file is missing or no feather file, or a column is missing, of another kind
            or has an empty or infinite cell.
    """
    if not path.is_file():
        raise InputError(path, "file", "is missing", _MEND)
    try:
        table = feather.read_table(path, memory_map=False)
    except (OSError, ValueError) as error:  # pyarrow's own errors are ValueErrors
        raise InputError(path, "feather table", f"cannot be read ({error})", _MEND) from None
    return {
        **{name: _numbers(path, table, name) for name in numbers},
        **{name: _words(path, table, name) for name in words},
    }


def poses(path: Path, columns: Columns) -> Array:
    """Transforms (N, 4, 4) of the quaternions and translations of a table.

    Raises:
        InputError: a quaternion is not of unit length.
    """
    quat = np.stack([columns[name].astype(np.float64) for name in QUATERNION], axis=-1)
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
    return se3.from_rotation_translation(se3.quat_to_matrix(quat), translation)


def _column(path: Path, table: Any, name: str) -> Any:
    if name not in table.column_names:
        found = ", ".join(table.column_names) or "no columns"
        raise InputError(path, f"column {name}", f"is missing (found {found})", _MEND)
    column = table[name]
    if column.null_count:
        row = column.is_null().to_pylist().index(True)
        raise InputError(path, f"column {name}, row {row}", "is empty", _MEND)
    return column


def _numbers(path: Path, table: Any, name: str) -> NDArray[Any]:
    column = _column(path, table, name)
    if not (pa.types.is_integer(column.type) or pa.types.is_floating(column.type)):
        raise InputError(path, f"column {name}", f"holds {column.type}, not numbers", _MEND)
    values: NDArray[Any] = column.to_numpy()
    wrong = np.flatnonzero(~np.isfinite(values))
    if len(wrong):
        where = f"column {name}, row {wrong[0]}"
        raise InputError(path, where, f"is {values[wrong[0]]}, not a number", _MEND)
    return values


def _words(path: Path, table: Any, name: str) -> NDArray[Any]:
    column = _column(path, table, name)
    if pa.types.is_dictionary(column.type):
        column = column.cast(column.type.value_type)
    if not (pa.types.is_string(column.type) or pa.types.is_large_string(column.type)):
        raise InputError(path, f"column {name}", f"holds {column.type}, not text", _MEND)
    return np.array(column.to_pylist(), dtype=np.str_)
