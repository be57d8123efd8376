"""What a parquet file takes in memory, from its footer and page headers, before it is decoded.

A column's metadata may claim less than its pages do, and the reader takes the memory that each page
claims for itself. The metadata is read here and not through pyarrow, whose accessors end the
process (`std::terminate`) on some damage that its reader only refuses.
Source: https://github.com/apache/parquet-format (parquet.thrift, Encodings.md).
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import IO, Any

from recast.tables.thrift import Compact

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
        values: in all pages; more than rows if they are in lists.
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
        raise ValueError("it is no parquet file, or cut short")
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
        metadata: as `Group.columns` has it.
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
                raise ValueError("texts as changes to the one before are not read")
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
            raise ValueError("its schema is no tree")
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
