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

from recast.logs.importers.waymo_segment import MEND, Place
from recast.logs.importers.waymo_values import rigid
from recast.logs.importers.waymo_wire import Choice, FieldError
from recast.logs.types import Array
from recast.tables import ROW_LIMIT, ParquetRows

SEGMENT, TIME = "key.segment_context_name", "key.frame_timestamp_micros"


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
        """A list of numbers (N,); empty if the cell is."""
        value = self.values[self.column(field)]
        value = [] if value is None else value
        if not isinstance(value, list) or not all(isinstance(one, (int, float)) for one in value):
            raise FieldError(self.column(field), "is no list of numbers")
        return np.array(value, np.float64)

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
        file = ParquetRows(self.path, columns, MEND)
        if file.first_rows[-1] > ROW_LIMIT:
            problem = f"there are {file.first_rows[-1]}, {ROW_LIMIT} are read at most"
            raise Place(self.path, "rows").error(problem)
        index = 0
        for group in range(len(file.first_rows) - 1):
            for batch in file.batches(group):
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
