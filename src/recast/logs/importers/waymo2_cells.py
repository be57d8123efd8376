"""Large cells of Waymo v2 tables, images and range images, read from their file when asked for.

A row group holds about fifty frames, a gigabyte of range images when decoded. So rows are decoded
one at a time, by one reader for all sensors of a table. Rows asked for in the order in which they
lie cost one pass over the file, so each sensor on its own costs one; a row that lies before the
last one in its row group costs another pass from the start of the group.
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
import pyarrow as pa

from recast.errors import InputError
from recast.logs.importers.waymo_segment import MEND, Place
from recast.logs.importers.waymo_values import shaped
from recast.logs.types import Float32Array
from recast.tables import ParquetRows


class RowReader:
    """Some columns of a parquet file, row by row; no more than a row is kept.

    Raises:
        InputError: the file is none, or lacks a column.
    """

    def __init__(self, path: Path, columns: Sequence[str]) -> None:
        self._file = ParquetRows(path, columns, MEND)
        self._batches: Iterator[pa.RecordBatch] = iter(())
        self._group, self._at = -1, -1
        self._row: pa.RecordBatch | None = None

    def cell(self, row: int, column: str) -> Any:
        """The pyarrow scalar in a row (counted from 0).

        Raises:
            InputError: the file is damaged.
        """
        first_rows = self._file.first_rows
        group = int(np.searchsorted(first_rows, row, side="right")) - 1
        if group != self._group or row < self._at:
            self._batches = self._file.batches(group, rows_at_once=1)
            self._group, self._at = group, int(first_rows[group]) - 1
        try:
            while self._at < row:
                self._row = None  # frees it before the next is decoded
                self._row = next(self._batches)
                self._at += 1
        except InputError:
            self._group = -1
            raise
        assert self._row is not None
        return self._row[column][0]


@dataclass(frozen=True)
class BytesCell:
    """Bytes in a cell; `StoredBytes`. The tables come without checksums."""

    reader: RowReader
    place: Place
    row: int
    column: str
    sealed: bool = False

    def error(self, problem: str, mend: str = MEND) -> InputError:
        """An error that names file, row and column."""
        return self.place.inside(self.column).error(problem, mend)

    def read(self) -> bytes:
        """The bytes.

        Raises:
            InputError: the file is damaged, or the cell is empty or holds something else.
        """
        value = self.reader.cell(self.row, self.column).as_py()
        if value is None:
            raise self.error("is empty")
        if not isinstance(value, bytes):
            raise self.error(f"holds {type(value).__name__}, not bytes")
        return value


@dataclass(frozen=True)
class MatrixCell:
    """A range image in two cells, FIELD.values and FIELD.shape; `StoredMatrix`.

    Attributes:
        shape: as its cell has it.
    """

    reader: RowReader
    place: Place
    row: int
    column: str
    shape: tuple[int, ...]

    def error(self, problem: str, mend: str = MEND) -> InputError:
        """An error that names file, row and column."""
        return self.place.inside(self.column).error(problem, mend)

    def read(self, channels: int) -> Float32Array:
        """The (H, W, channels) float32 matrix.

        Raises:
            InputError: it is empty, damaged, or of another shape.
        """
        cell = self.reader.cell(self.row, self.column)
        values = getattr(cell, "values", None)
        if values is None or len(values) == 0:
            raise self.error("is empty")
        try:
            # An empty element becomes a NaN, which is refused.
            return shaped(values.to_numpy(zero_copy_only=False), self.shape, channels)
        except (TypeError, ValueError) as error:
            raise self.error(str(error)) from None
