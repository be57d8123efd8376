"""Parquet files; what they take in memory is known from footer and page headers before decoding.

A column's metadata may claim less than its pages, for which the reader takes what each claims. It
is read here and not through pyarrow, whose accessors end the process on damage that its reader only
refuses. Source: https://github.com/apache/parquet-format (parquet.thrift, Encodings.md).
"""

from __future__ import annotations

import os
from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import IO, Any

import numpy as np
import pyarrow as pa
import pyarrow.parquet as pq

from recast.core.errors import InputError
from recast.core.files import atomic_file
from recast.tables.arrow import ROW_LIMIT, ArrowTable, arrow_errors, require_plain
from recast.tables.encodings import Compact

FOOTER_LIMIT = 1 << 20
"""Bytes of a footer, at most."""

_HEADER_LIMIT = 1 << 16
_MAGIC = b"PAR1"
_DATA, _DICTIONARY, _DATA_V2 = 0, 2, 3
_COUNTS = {_DATA: 5, _DATA_V2: 8}
"""The field of a page header that holds its number of values, in field 1, and its encoding."""
_ENCODING = {_DATA: 2, _DATA_V2: 4}
_DELTA_BYTE_ARRAY = 7
_BYTE_ARRAY = 6
_WIDTHS = {0: 1, 1: 4, 4: 4}  # bool, int32, float; 8 or less any other
_REPEATED = 2
_LEVELS = 4
"""Bytes of a value's definition and repetition level."""
PARQUET_LIMIT = 1 << 28
"""Bytes in memory of a parquet table that is read as a whole, at most."""
STREAM_LIMIT = 1 << 32
"""Bytes in memory while a parquet file is read piece by piece, at most: in the worst case all
values of a column in a row group lie in one row, and range images of a Waymo segment have 5e8."""

_ROWS_AT_ONCE = 1024


def read_parquet(
    path: Path, columns: Sequence[str], mend: str, limit: int = PARQUET_LIMIT
) -> ArrowTable:
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
    return ArrowTable(Path(path), mend, pa.Table.from_batches(batches, rows.schema))


def write_parquet(path: Path, table: pa.Table) -> None:
    """Write a table, whole or not at all; the same table gives the same bytes.

    Raises:
        InputError: the disk refuses.
    """
    with atomic_file(path) as partial, partial.open("wb") as stream:
        pq.write_table(table, stream)


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
            with self._path.open("rb") as file:
                self._leaves, self._groups = read_footer(file, self._path.stat().st_size)
            # Column chunks are read bit by bit: whole, those of a row group may be 100 MB.
            stream = pa.OSFile(os.fsencode(self._path))  # a text would be taken as UTF-8
            self._file = pq.ParquetFile(stream, buffer_size=1 << 20)
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


@dataclass(frozen=True)
class Leaf:
    """A stored column: a column of the table, or the values of one of lists.

    Attributes:
        path: its parents' names and its own, joined by dots.
        width: bytes of a value in memory; if it is a text, bytes of its length and offset.
        texts: whether each value has a length of its own.
        nested: whether values are in lists, each of unknown length.
    """

    path: str
    width: int
    texts: bool
    nested: bool


@dataclass(frozen=True)
class Group:
    """A row group: its number of rows, and the metadata of each leaf in it."""

    rows: int
    columns: Sequence[dict[int, Any]]


@dataclass(frozen=True)
class Chunk:
    """A leaf in a row group, as its pages say.

    Attributes:
        values: number of values in all pages; more than rows if they are in lists.
        pages, dictionary: bytes of all data pages and of the dictionary, decompressed.
        largest: bytes of the largest page, decompressed.
    """

    leaf: Leaf
    values: int
    pages: int
    dictionary: int
    largest: int

    def size_of(self, rows: int) -> int:
        """Bytes in memory of any `rows` rows, at most.

        Each of them may hold the longest text of the dictionary; one may hold all lists' values.
        """
        values = self.values if self.leaf.nested else rows
        size = 2 * self.largest + self.dictionary + values * (self.leaf.width + _LEVELS)
        if self.leaf.texts:
            size += min(self.pages, rows * self.largest) + rows * self.dictionary
        return size


def read_footer(stream: IO[bytes], size: int) -> tuple[list[Leaf], list[Group]]:
    """Leaves and row groups of a file of `size` bytes.

    Raises:
        ValueError: it is no parquet file, or its footer is damaged or too long.
    """
    if size < 12:
        raise ValueError("it is too short")
    stream.seek(size - 8)
    length = int.from_bytes(stream.read(4), "little")
    if stream.read(4) != _MAGIC:
        raise ValueError("it is not a parquet file, or it is truncated")
    if length > min(size - 12, FOOTER_LIMIT):
        raise ValueError(f"its footer has {length} bytes, {FOOTER_LIMIT} are read at most")
    stream.seek(size - 8 - length)
    footer = Compact(stream.read(length)).struct()
    leaves = _leaves(_structs(footer, 2))
    groups = [
        Group(_count(row, 3), [_struct(column, 3) for column in _structs(row, 1)])
        for row in _structs(footer, 4)
    ]
    if any(len(group.columns) != len(leaves) for group in groups):
        raise ValueError("a row group has more or fewer columns than the schema")
    return leaves, groups


def read_chunk(stream: IO[bytes], leaf: Leaf, metadata: dict[int, Any], rows: int) -> Chunk:
    """Go through the page headers of a leaf in a row group.

    Args:
        metadata: metadata of the leaf in the row group, as `Group.columns` has it.
        rows: number of rows of the row group.

    Raises:
        ValueError: a header is damaged, or contradicts the metadata; or texts are stored as changes
            to the one before, whose size in memory no header tells.
    """
    values, stored, at = (_count(metadata, field) for field in (5, 7, 9))
    if metadata.get(11) is not None and 0 < _count(metadata, 11) < at:
        at = metadata[11]
    end = at + stored
    pages = dictionary = largest = seen = 0
    while seen < values:
        if not 0 < at < end:
            raise ValueError("pages lie outside of their column")
        stream.seek(at)
        compact = Compact(stream.read(min(_HEADER_LIMIT, end - at)))
        header = compact.struct()
        kind, size, stored = (_count(header, field) for field in (1, 2, 3))
        if kind == _DICTIONARY:
            dictionary += size
        elif kind in _COUNTS:
            counts = _struct(header, _COUNTS[kind])
            if counts.get(_ENCODING[kind]) == _DELTA_BYTE_ARRAY:
                raise ValueError("delta-encoded texts are not supported")
            pages += size
            seen += _count(counts, 1)
        largest = max(largest, size)
        at += compact.at + stored
    if at > end or seen != values or values < rows or (values != rows and not leaf.nested):
        raise ValueError("pages hold more or fewer values than the file says")
    return Chunk(leaf, values, pages, dictionary, largest)


def _leaves(elements: Sequence[dict[int, Any]]) -> list[Leaf]:
    """Leaves of a schema, which lists each element before its children."""
    leaves = []
    open_groups: list[tuple[int, str, bool]] = []  # children to come, path and whether in lists
    for number, element in enumerate(elements):
        while open_groups and open_groups[-1][0] == 0:
            open_groups.pop()
        if (number > 0) != bool(open_groups):
            raise ValueError("its schema is not a tree")
        prefix, nested = "", False
        if open_groups:
            left, prefix, nested = open_groups.pop()
            open_groups.append((left - 1, prefix, nested))
        name = element.get(4, b"")
        path = f"{prefix}{name.decode(errors='replace') if isinstance(name, bytes) else ''}"
        nested = nested or element.get(3) == _REPEATED
        children = _count(element, 5) if 5 in element else 0
        if children:
            open_groups.append((children, f"{path}." if number else "", nested))
        else:
            width = _WIDTHS.get(element.get(1, -1), 8) + (_count(element, 2) if 2 in element else 0)
            leaves.append(Leaf(path, width, element.get(1) == _BYTE_ARRAY, nested))
    return leaves


def _structs(fields: dict[int, Any], field: int) -> list[dict[int, Any]]:
    value = fields.get(field, [])
    if not isinstance(value, list) or not all(isinstance(one, dict) for one in value):
        raise ValueError("its metadata is damaged")
    return value


def _struct(fields: dict[int, Any], field: int) -> dict[int, Any]:
    value = fields.get(field)
    if not isinstance(value, dict):
        raise ValueError("its metadata is damaged")
    return value


def _count(fields: dict[int, Any], field: int) -> int:
    value = fields.get(field)
    if not isinstance(value, int) or not 0 <= value < 1 << 62:
        raise ValueError("its metadata is damaged")
    return value
