"""A table in memory, whose columns are checked when they are asked for."""

from __future__ import annotations

from collections.abc import Iterable, Iterator
from contextlib import contextmanager
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
import pyarrow as pa
from numpy.typing import NDArray

from recast.errors import InputError
from recast.storage import disk_errors

ROW_LIMIT = 1 << 22
"""Rows of a table in memory, at most: a text takes up to 60 bytes beside its characters."""


@dataclass(frozen=True)
class Table:
    """Some columns of a file, validated in full by Arrow.

    Attributes:
        path: the file, for messages.
        mend: what the user can do about any fault in it.
        data: at most `ROW_LIMIT` rows; every column is plain (see `require_plain`).
    """

    path: Path
    mend: str
    data: pa.Table

    def __len__(self) -> int:
        """Number of rows."""
        return int(self.data.num_rows)

    def numbers(self, name: str) -> NDArray[Any]:
        """A column (N,) of integers or floats, as stored; all are finite.

        Raises:
            InputError: it holds something else, or a cell is empty or not finite.
        """
        column = self._column(name)
        if not _is_number(column.type):
            raise self._error(f"column {name}", f"holds {_name(column.type)}, not numbers")
        values: NDArray[Any] = column.to_numpy()
        wrong = np.flatnonzero(~np.isfinite(values))
        if len(wrong):
            problem = f"is {values[wrong[0]]}, not a number"
            raise self._error(f"column {name}, row {wrong[0]}", problem)
        return values

    def words(self, name: str) -> NDArray[np.object_]:
        """A column (N,) of str, plain or by dictionary.

        Raises:
            InputError: it holds something else, or a cell is empty.
        """
        column = self._column(name)
        if not _is_text(column.type):
            raise self._error(f"column {name}", f"holds {_name(column.type)}, not text")
        words = np.empty(len(self), np.object_)
        row = 0
        for chunk in column.chunks:
            if pa.types.is_dictionary(chunk.type):  # each text once, however often it is used
                values = np.array([*chunk.dictionary.to_pylist(), None], np.object_)
                found = values[chunk.indices.to_numpy(zero_copy_only=False)]
            else:
                found = chunk.to_pylist()
            words[row : row + len(chunk)] = found
            row += len(chunk)
        empty = [row for row, word in enumerate(words) if word is None]
        if empty:  # empty in the dictionary
            raise self._error(f"column {name}, row {empty[0]}", "is empty")
        return words

    def lists(self, name: str, width: int) -> NDArray[np.float64]:
        """A column of lists of `width` finite numbers each, (N, width).

        Raises:
            InputError: it holds something else, or a cell or a number in it is empty, of another
                length or not finite.
        """
        column = self._column(name)
        if not _is_list(column.type):
            raise self._error(f"column {name}", f"holds {_name(column.type)}, not lists of numbers")
        rows: list[NDArray[np.float64]] = [np.empty((0, width))]
        for chunk in column.chunks:
            lengths = _lengths(chunk)
            wrong = np.flatnonzero(lengths != width)
            if len(wrong):
                where = f"column {name}, row {sum(map(len, rows)) + wrong[0]}"
                raise self._error(where, f"has {lengths[wrong[0]]} numbers, not {width}")
            flat = chunk.flatten().to_numpy(zero_copy_only=False)  # an empty one becomes NaN
            rows.append(flat.astype(np.float64).reshape(len(chunk), width))
        values = np.concatenate(rows)
        wrong = np.flatnonzero(~np.isfinite(values).all(axis=1))
        if len(wrong):
            raise self._error(f"column {name}, row {wrong[0]}", "holds NaN or infinity")
        return values

    def _column(self, name: str) -> pa.ChunkedArray:
        column = self.data[name]
        if column.null_count:
            row = column.is_null().to_pylist().index(True)
            raise self._error(f"column {name}, row {row}", "is empty")
        return column

    def _error(self, field: str, problem: str) -> InputError:
        return InputError(self.path, field, problem, self.mend)


def require_plain(path: Path, schema: pa.Schema, columns: Iterable[str], mend: str) -> None:
    """Only types whose size in memory is known: numbers, text, bytes, and lists of numbers.

    Raises:
        InputError: a column is missing, there twice, or of another type.
    """
    for name in columns:
        indices = schema.get_all_field_indices(name)
        if len(indices) != 1:
            problem = "is there twice" if indices else "is missing"
            raise InputError(path, f"column {name}", problem, mend)
        kind = schema.field(indices[0]).type
        plain = _is_number(kind) or _is_text(kind) or _is_bytes(kind) or _is_list(kind)
        if not plain and not pa.types.is_boolean(kind) and not pa.types.is_null(kind):
            problem = f"holds {_name(kind)}, not numbers, text, bytes or lists of numbers"
            raise InputError(path, f"column {name}", problem, mend)


@contextmanager
def arrow_errors(path: Path, field: str, mend: str) -> Iterator[None]:
    """Turn whatever Arrow raises on damaged bytes into one line that names the file.

    Raises:
        InputError: in place of any other error.
    """
    try:
        with disk_errors(path):
            yield
    except InputError:
        raise
    except Exception as error:  # Arrow's own, and MemoryError, UnicodeDecodeError, SystemError, ...
        reason = " ".join(str(error).split()) or type(error).__name__
        raise InputError(path, field, f"cannot be read ({reason})", mend) from None


def _lengths(chunk: pa.Array) -> NDArray[np.int64]:
    if pa.types.is_fixed_size_list(chunk.type):
        return np.full(len(chunk), chunk.type.list_size)
    return np.diff(chunk.offsets.to_numpy()).astype(np.int64)


def _is_number(kind: pa.DataType) -> bool:
    return bool(pa.types.is_integer(kind) or pa.types.is_floating(kind))


def _is_text(kind: pa.DataType) -> bool:
    if pa.types.is_dictionary(kind):
        kind = kind.value_type
    return bool(pa.types.is_string(kind) or pa.types.is_large_string(kind))


def _is_bytes(kind: pa.DataType) -> bool:
    return bool(pa.types.is_binary(kind) or pa.types.is_large_binary(kind))


def _is_list(kind: pa.DataType) -> bool:
    lists = (pa.types.is_list, pa.types.is_large_list, pa.types.is_fixed_size_list)
    return any(of(kind) for of in lists) and _is_number(kind.value_type)


def _name(kind: pa.DataType) -> str:
    # Names of nested types may be as long as the file.
    text = str(kind)
    return text if len(text) <= 40 else text[:37] + "..."
