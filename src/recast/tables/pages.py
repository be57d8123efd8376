"""Page headers of parquet files: what a column chunk takes in memory, before it is decoded.

A chunk's own metadata may claim less than its pages do, and the reader takes the memory that each
page claims for itself. Headers are in Thrift's compact encoding.
Sources: https://github.com/apache/parquet-format (parquet.thrift, Encodings.md) and
https://github.com/apache/thrift/blob/master/doc/specs/thrift-compact-protocol.md
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import IO, Any

HEADER_LIMIT = 1 << 16
"""Bytes of a page header, at most."""

_DATA, _DICTIONARY, _DATA_V2 = 0, 2, 3
_COUNTS = {_DATA: 5, _DATA_V2: 8}
"""The field of a page header that holds its number of values, in field 1, and its encoding."""
_ENCODING = {_DATA: 2, _DATA_V2: 4}
_DELTA_BYTE_ARRAY = 7
_BYTE_ARRAY = "BYTE_ARRAY"
_LEVELS = 4
"""Bytes of a value's definition and repetition level."""
_DEPTH = 4


@dataclass(frozen=True)
class Chunk:
    """A column in a row group, as its pages say.

    Attributes:
        rows: in the row group.
        values: in all pages; more than rows if they are in lists.
        width: bytes of a value; of a text, those of its length and place.
        pages, dictionary: bytes of all data pages and of the dictionary, decompressed.
        largest: bytes of the largest page, decompressed.
        texts: whether values have each its own length.
        nested: whether values are in lists, each of unknown length.
    """

    rows: int
    values: int
    width: int
    pages: int
    dictionary: int
    largest: int
    texts: bool
    nested: bool

    def size_of(self, rows: int) -> int:
        """Bytes in memory of any `rows` rows, at most.

        Each of them may hold the longest text of the dictionary; one may hold all lists' values.
        """
        values = self.values if self.nested else rows
        texts = min(self.pages, rows * self.largest) + rows * self.dictionary if self.texts else 0
        return 2 * self.largest + self.dictionary + values * (self.width + _LEVELS) + texts


def read_chunk(stream: IO[bytes], metadata: Any, rows: int, width: int, nested: bool) -> Chunk:
    """Go through the pages of a column chunk.

    Args:
        stream: the file.
        metadata: pyarrow's `ColumnChunkMetaData`.
        rows: of the row group.
        width: bytes of a value, at least.
        nested: whether its values are in lists.

    Raises:
        ValueError: a header is damaged, or contradicts the metadata; or texts are stored as changes
            to the one before, whose size in memory no header tells.
    """
    at, values = metadata.data_page_offset, metadata.num_values
    if metadata.has_dictionary_page and 0 < metadata.dictionary_page_offset < at:
        at = metadata.dictionary_page_offset
    end = at + metadata.total_compressed_size
    pages = dictionary = largest = seen = 0
    while seen < values:
        if not 0 < at < end:
            raise ValueError("pages lie outside of their column")
        stream.seek(at)
        compact = _Compact(stream.read(min(HEADER_LIMIT, end - at)))
        header = compact.struct()
        kind, size, stored = (_count(header, field) for field in (1, 2, 3))
        if kind == _DICTIONARY:
            dictionary += size
        elif kind in _COUNTS:
            counts = header.get(_COUNTS[kind], {})
            if counts.get(_ENCODING[kind]) == _DELTA_BYTE_ARRAY:
                raise ValueError("texts as changes to the one before are not read")
            pages += size
            seen += _count(counts, 1)
        largest = max(largest, size)
        at += compact.at + stored
    texts = metadata.physical_type == _BYTE_ARRAY
    if at > end or seen != values or values < rows or (values != rows and not nested):
        raise ValueError("pages hold more or fewer values than the file says")
    return Chunk(rows, values, width, pages, dictionary, largest, texts, nested)


def _count(fields: dict[int, Any], field: int) -> int:
    value = fields.get(field)
    if not isinstance(value, int) or not 0 <= value < 1 << 31:
        raise ValueError("a page header is damaged")
    return value


class _Compact:
    """Thrift's compact encoding, as far as page headers need it: numbers, bytes and structs."""

    def __init__(self, data: bytes) -> None:
        self._data = data
        self.at = 0

    def struct(self, depth: int = 0) -> dict[int, Any]:
        """Fields by number."""
        if depth > _DEPTH:
            raise ValueError("a page header is nested too deeply")
        fields: dict[int, Any] = {}
        number = 0
        while first := self._bytes(1)[0]:
            number = number + (first >> 4) if first >> 4 else self._integer()
            fields[number] = self._value(first & 15, depth)
        return fields

    def _value(self, kind: int, depth: int) -> Any:
        if kind in (1, 2):  # true and false have no more bytes
            return kind == 1
        if kind == 3:
            return self._bytes(1)[0]
        if kind in (4, 5, 6):
            return self._integer()
        if kind == 7:
            return self._bytes(8)
        if kind == 8:
            return self._bytes(self._varint())
        if kind == 12:
            return self.struct(depth + 1)
        raise ValueError("a page header holds a field of unknown kind")

    def _integer(self) -> int:
        value = self._varint()
        return (value >> 1) ^ -(value & 1)

    def _varint(self) -> int:
        value = 0
        for shift in range(0, 70, 7):
            byte = self._bytes(1)[0]
            value |= (byte & 127) << shift
            if byte < 128:
                return value
        raise ValueError("a page header holds a number of more than 64 bits")

    def _bytes(self, count: int) -> bytes:
        if self.at + count > len(self._data):
            raise ValueError("a page header is cut short")
        self.at += count
        return self._data[self.at - count : self.at]
