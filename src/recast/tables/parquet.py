"""Parquet files, whose size in memory is known before they are decoded."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from pathlib import Path

import numpy as np
import pyarrow as pa
import pyarrow.parquet as pq

from recast.errors import InputError
from recast.tables.columns import ROW_LIMIT, Table, arrow_errors, require_plain
from recast.tables.pages import Chunk, read_chunk

PARQUET_LIMIT = 1 << 28
"""Bytes in memory of a parquet table that is read as a whole, at most."""
STREAM_LIMIT = 1 << 31
"""Bytes in memory while a parquet file is read piece by piece, at most: in the worst case all
values of a column in a row group lie in one row, and Waymo's have a hundred million."""

_FOOTER_LIMIT = 1 << 20
_MAGIC = b"PAR1"
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
    batches = []
    for group in range(len(rows.first_rows) - 1) if count <= ROW_LIMIT else ():
        for batch in rows.batches(group, rows_at_once=ROW_LIMIT):
            size += batch.nbytes
            if size <= limit:
                batches.append(batch)
    if count > ROW_LIMIT or size > limit:
        problem = f"has {count} rows of {size} bytes; at most {ROW_LIMIT} and {limit} are read"
        raise InputError(path, "parquet table", problem, mend)
    return Table(Path(path), mend, pa.Table.from_batches(batches, rows.schema))


class ParquetRows:
    """Some columns of a parquet file, read piece by piece.

    Attributes:
        schema: of these columns.
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
            self._check_footer()
            # Column chunks are read bit by bit: whole, those of a row group may be 100 MB.
            self._file = pq.ParquetFile(self._path, buffer_size=1 << 20)
            schema = self._file.schema_arrow
            require_plain(self._path, schema, columns, mend)
            self.schema = pa.schema([schema.field(name) for name in columns])
            metadata = self._file.metadata
            rows = [metadata.row_group(i).num_rows for i in range(metadata.num_row_groups)]
            if min(rows, default=0) < 0:
                raise ValueError("a row group has fewer than no rows")
        self.first_rows = np.cumsum([0, *rows], dtype=np.int64)
        self._leaves = self._leaf_columns()
        self._chunks: dict[int, list[Chunk]] = {}

    def size_of(self, group: int, rows: int | None = None) -> int:
        """Bytes in memory of a row group, or of any `rows` of it, at most.

        Raises:
            InputError: the file is damaged.
        """
        if group not in self._chunks:
            with (
                arrow_errors(self._path, f"row group {group}", self._mend),
                self._path.open("rb") as stream,
            ):
                metadata = self._file.metadata.row_group(group)
                self._chunks[group] = [
                    read_chunk(stream, metadata.column(leaf), metadata.num_rows, width, nested)
                    for leaf, width, nested in self._leaves
                ]
        count = int(np.diff(self.first_rows)[group])
        rows = count if rows is None else min(rows, count)
        return sum(chunk.size_of(rows) for chunk in self._chunks[group])

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
        left = int(np.diff(self.first_rows)[group])
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

    def _check_footer(self) -> None:
        with self._path.open("rb") as stream:
            size = self._path.stat().st_size
            if size < 12:
                raise ValueError("is too short")
            stream.seek(size - 8)
            length = int.from_bytes(stream.read(4), "little")
            if stream.read(4) != _MAGIC:
                raise ValueError("no parquet file, or cut short")
        if length > min(size, _FOOTER_LIMIT):
            raise ValueError(f"the footer has {length} bytes, {_FOOTER_LIMIT} are read at most")

    def _leaf_columns(self) -> list[tuple[int, int, bool]]:
        """Number, bytes of a value and whether it is in lists, of each stored column needed."""
        schema = self._file.metadata.schema
        leaves = [schema.column(i) for i in range(len(schema.names))]
        return [
            (i, max(8, leaf.length or 0), leaf.max_repetition_level > 0)
            for i, leaf in enumerate(leaves)
            # As Arrow chooses them: a.b is column b of a, or has that name.
            if any(leaf.path == name or leaf.path.startswith(f"{name}.") for name in self._columns)
        ]
