"""Tables of Waymo v2: one parquet file for each component of a segment, checked as they are read.

A file lies at COMPONENT/SEGMENT.parquet. Columns are named `key.NAME` (what the row is of) and
`[Component].field`.
"""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
import pyarrow as pa
import pyarrow.parquet as pq

from recast.errors import InputError
from recast.logs.importers.waymo_segment import MEND, Place
from recast.logs.importers.waymo_values import rigid
from recast.logs.importers.waymo_wire import Choice, FieldError
from recast.logs.types import Array

SEGMENT, TIME = "key.segment_context_name", "key.frame_timestamp_micros"
_ROWS_AT_ONCE = 1024


@dataclass(frozen=True)
class Row:
    """A row of a table; its values are checked when asked for, and raise FieldError.

    Attributes:
        table: that has it.
        index: counted from 0.
        values: by column.
    """

    table: Table
    index: int
    values: Mapping[str, Any]

    @property
    def place(self) -> Place:
        """The file and the number of the row."""
        return Place(self.table.path, f"row {self.index}")

    def column(self, field: str) -> str:
        """The column of a field."""
        return self.table.column(field)

    def integer(self, field: str) -> int:
        """An integer."""
        value = self._present(field)
        if not isinstance(value, int):
            raise FieldError(self.column(field), f"is {value!r}, not an integer")
        return value

    def number(self, field: str) -> float:
        """A number; it may be infinite or none."""
        value = self._present(field)
        if not isinstance(value, (int, float)):
            raise FieldError(self.column(field), f"is {value!r}, not a number")
        return float(value)

    def text(self, field: str) -> str:
        """A text."""
        value = self._present(field)
        if not isinstance(value, str):
            raise FieldError(self.column(field), f"is {value!r}, not text")
        return value

    def choice(self, field: str, choice: Choice) -> str:
        """The name of an enumeration's value: some files hold the number, some the name itself."""
        value = self._present(field)
        if isinstance(value, str) and value in choice.names.values():
            return value
        if not isinstance(value, int):
            raise FieldError(self.column(field), f"is {value!r}, no {choice.name}")
        return choice.of(value, self.column(field))

    def numbers(self, field: str) -> Array:
        """A list of numbers (N,); empty where there is none."""
        try:
            return np.array(self.values[self.column(field)] or [], np.float64)
        except (TypeError, ValueError):
            raise FieldError(self.column(field), "is no list of numbers") from None

    def pose(self, field: str) -> Array:
        """A (4, 4) pose in the field `field`.transform."""
        self._present(f"{field}.transform")
        return rigid(self.numbers(f"{field}.transform"), self.column(f"{field}.transform"))

    def _present(self, field: str) -> Any:
        value = self.values[self.column(field)]
        if value is None:
            raise FieldError(self.column(field), "is empty")
        return value


@dataclass(frozen=True)
class Table:
    """One component of a segment.

    Attributes:
        path: its file, named after the segment.
        component: as in the names of its columns.
    """

    path: Path
    component: str

    def column(self, field: str) -> str:
        """The column of a field; keys are columns already."""
        return field if field.startswith("key.") else f"[{self.component}].{field}"

    def rows(self, fields: Sequence[str]) -> Iterator[Row]:
        """All rows with the keys (`key.NAME`) and fields asked for, a thousand in memory at once.

        Raises:
            InputError: the file is none, lacks a column, or has rows of another segment.
        """
        columns = [SEGMENT, *(self.column(field) for field in fields)]
        file = open_parquet(self.path, columns)
        batches = file.iter_batches(_ROWS_AT_ONCE, columns=columns, use_threads=False)
        index = 0
        while True:
            try:
                batch = next(batches, None)
            except (OSError, pa.ArrowException) as error:
                raise unreadable(Place(self.path, f"row {index}"), error) from None
            if batch is None:
                return
            for values in batch.to_pylist():
                row = Row(self, index, values)
                self._check_segment(row)
                yield row
                index += 1

    def _check_segment(self, row: Row) -> None:
        with row.place.errors():
            name = row.text(SEGMENT)
            if name != self.path.stem:
                raise FieldError(SEGMENT, f"is {name!r}, the file is of {self.path.stem!r}")


def open_parquet(path: Path, columns: Sequence[str]) -> pq.ParquetFile:
    """A parquet file that has these columns.

    Raises:
        InputError: it is none, or lacks one.
    """
    try:
        # Column chunks are read piece by piece: whole, those of one row group can be 100 MB.
        file = pq.ParquetFile(path, buffer_size=1 << 20)
        names = set(file.schema_arrow.names)
    except (OSError, pa.ArrowException) as error:
        raise unreadable(Place(path, "parquet file"), error) from None
    for column in columns:
        if column not in names:
            raise InputError(path, f"column {column}", "is missing", MEND)
    return file


def unreadable(place: Place, error: Exception) -> InputError:
    """Arrow's own message, on one line."""
    return place.error(f"cannot be read ({' '.join(str(error).split())})")
