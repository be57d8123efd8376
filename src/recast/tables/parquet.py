"""Parquet files, whose size in memory is known before they are decoded."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from pathlib import Path

import numpy as np
import pyarrow as pa
import pyarrow.parquet as pq

from recast.errors import InputError
from recast.tables.columns import ROW_LIMIT, Table, arrow_errors, require_plain
from recast.tables.parquet_pages import Chunk, read_chunk, read_footer

PARQUET_LIMIT = 1 << 28
"""Bytes in memory of a parquet table that is read as a whole, at most."""
STREAM_LIMIT = 1 << 32
"""Bytes in memory while a parquet file is read piece by piece, at most: in the worst case all
values of a column in a row group lie in one row, and range images of a Waymo segment have 5e8."""

_ROWS_AT_ONCE = 1024


def read_parquet(
    path: Path, columns: Sequence[str], mend: str, limit: int = PARQUET_LIMIT
) -> Table:
    """Columns of a parquet file; others that it has are not decoded.

    Args:
        mend: what the user can do about any fault.
        limit: bytes that the columns may take in memory.

    Raises:
        InputError: the file is missing or damaged, has more than `ROW_LIMIT` rows, takes more than
            `limit` bytes, or a column is missing or of no plain type.
    """
    rows = ParquetRows(path, columns, mend, limit)
    count, size = int(rows.first_rows[-1]), 0
    if count > ROW_LIMIT:
        problem = f"has {count} rows, {ROW_LIMIT} are read at most"
        raise InputError(path, "parquet table", problem, mend)
    batches = []
    for group in range(len(rows.first_rows) - 1):
        for batch in rows.batches(group, rows_at_once=ROW_LIMIT):
            batches.append(batch)
            size += batch.nbytes
            if size > limit:
                problem = f"has {count} rows of more than {limit} bytes in memory"
                raise InputError(path, "parquet table", problem, mend)
    return Table(Path(path), mend, pa.Table.from_batches(batches, rows.schema))


class ParquetRows:
    """Some columns of a parquet file, read piece by piece.

    Attributes:
        schema: Arrow schema of these columns.
        first_rows: (groups + 1,) the number of each row group's first row, and of all rows.
    """

    def __init__(
        self, path: Path, columns: Sequence[str], mend: str, limit: int = STREAM_LIMIT
    ) -> None:
        """Open a file and read what it says of itself.

        Args:
            mend: what the user can do about any fault.
            limit: bytes that a piece may take in memory.

        Raises:
            InputError: the file is missing or damaged, or a column is missing or of no plain type.
        """
        self._path, self._columns, self._mend, self._limit = Path(path), [*columns], mend, limit
        if not self._path.is_file():
            raise InputError(path, "file", "is missing", mend)
        with arrow_errors(self._path, "parquet file", mend):
            with self._path.open("rb") as stream:
                self._leaves, self._groups = read_footer(stream, self._path.stat().st_size)
            # Column chunks are read bit by bit: whole, those of a row group may be 100 MB.
            self._file = pq.ParquetFile(self._path, buffer_size=1 << 20)
            schema = self._file.schema_arrow
            require_plain(self._path, schema, columns, mend)
            self.schema = pa.schema([schema.field(name) for name in columns])
        self.first_rows = np.cumsum([0, *(group.rows for group in self._groups)], dtype=np.int64)
        self._chunks: dict[int, list[Chunk]] = {}

    def size_of(self, group: int, rows: int) -> int:
        """Bytes in memory of any `rows` rows of a row group, at most.

        Raises:
            InputError: the file is damaged.
        """
        count = self._groups[group].rows
        if group not in self._chunks:
            with (
                arrow_errors(self._path, f"row group {group}", self._mend),
                self._path.open("rb") as stream,
            ):
                self._chunks[group] = [
                    read_chunk(stream, leaf, self._groups[group].columns[i], count)
                    for i, leaf in enumerate(self._leaves)
                    if self._is_read(leaf.path)
                ]
        return sum(chunk.size_of(min(rows, count)) for chunk in self._chunks[group])

    def batches(self, group: int, rows_at_once: int = _ROWS_AT_ONCE) -> Iterator[pa.RecordBatch]:
        """The rows of a row group in order, at most `rows_at_once` at a time, validated in full.

        Fewer at a time where a long text in a dictionary may be in all of them.

        Raises:
            InputError: the file is damaged, or a piece takes too much memory.
        """
        while (size := self.size_of(group, rows_at_once)) > self._limit and rows_at_once > 1:
            rows_at_once //= 2
        field = f"row group {group}"
        if size > self._limit:
            problem = f"takes {size} bytes in memory, {self._limit} at most"
            raise InputError(self._path, field, problem, self._mend)
        left = self._groups[group].rows
        with arrow_errors(self._path, field, self._mend):
            found = self._file.iter_batches(
                rows_at_once, row_groups=[group], columns=self._columns, use_threads=False
            )
        while left:
            with arrow_errors(self._path, field, self._mend):
                batch = next(found).select(self._columns)
                batch.validate(full=True)
                left -= batch.num_rows
            yield batch

    def _is_read(self, path: str) -> bool:
        # As Arrow chooses leaves: a.b is column b of a, or a column of that name.
        return any(path == name or path.startswith(f"{name}.") for name in self._columns)
