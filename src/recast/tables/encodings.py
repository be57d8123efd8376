"""Encodings of the metadata of Arrow and Parquet files, read within their bounds.

FlatBuffers (https://flatbuffers.dev/internals): all numbers are little-endian; a table begins with
the distance back to its vtable, which holds the place of each field, 0 where the default is meant.
Thrift's compact encoding:
https://github.com/apache/thrift/blob/master/doc/specs/thrift-compact-protocol.md
"""

from __future__ import annotations

from dataclasses import dataclass
from mmap import mmap
from typing import Any

import numpy as np
from numpy.typing import NDArray

Buffer = bytes | mmap
"""Bytes of a file."""
_STOP, _TRUE, _FALSE, _BYTE, _I16, _I32, _I64, _DOUBLE, _BINARY, _LIST, _SET, _MAP, _STRUCT = range(
    13
)
_DEPTH = 16


def integer(data: Buffer, at: int, size: int, signed: bool = True) -> int:
    """The integer of `size` bytes at `at`.

    Raises:
        ValueError: it lies outside of `data`.
    """
    if at < 0 or at + size > len(data):
        raise ValueError("an offset leads out of the metadata")
    return int.from_bytes(data[at : at + size], "little", signed=signed)


@dataclass(frozen=True)
class FlatTable:
    """One table.

    Attributes:
        data: the whole FlatBuffer.
        at: offset in bytes at which the table begins.
    """

    data: bytes
    at: int

    @classmethod
    def root(cls, data: bytes) -> FlatTable:
        """The root table of a FlatBuffer."""
        return cls(data, integer(data, 0, 4, signed=False))

    def integer(self, slot: int, size: int) -> int:
        """The signed integer in field `slot`; 0 where it is not stored.

        Raises:
            ValueError: see `integer`.
        """
        place = self._place(slot)
        return 0 if place is None else integer(self.data, place, size)

    def table(self, slot: int) -> FlatTable | None:
        """The table that field `slot` refers to.

        Raises:
            ValueError: see `integer`.
        """
        place = self._target(slot)
        return None if place is None else FlatTable(self.data, place)

    def structs(self, slot: int, layout: np.dtype[np.void]) -> NDArray[np.void]:
        """The vector of structs (N,) in field `slot`.

        Raises:
            ValueError: it is longer than the bytes.
        """
        place = self._target(slot)
        if place is None:
            return np.empty(0, layout)
        count = integer(self.data, place, 4, signed=False)
        if place + 4 + count * layout.itemsize > len(self.data):
            raise ValueError("a list is longer than the metadata")
        return np.frombuffer(self.data, layout, count, place + 4)

    def _target(self, slot: int) -> int | None:
        place = self._place(slot)
        return None if place is None else place + integer(self.data, place, 4, signed=False)

    def _place(self, slot: int) -> int | None:
        vtable = self.at - integer(self.data, self.at, 4)
        entry = 4 + 2 * slot
        if entry + 2 > integer(self.data, vtable, 2, signed=False):
            return None
        offset = integer(self.data, vtable + entry, 2, signed=False)
        return self.at + offset if offset else None


class Compact:
    """Reader of the values in `data`, one after the other from the first byte on.

    Attributes:
        at: offset of the next byte.
    """

    def __init__(self, data: bytes) -> None:
        self._data = data
        self.at = 0

    def struct(self, depth: int = 0) -> dict[int, Any]:
        """Fields by number: int, bool, bytes (also for doubles), list or dict.

        Raises:
            ValueError: the bytes are cut short or no such encoding.
        """
        if depth > _DEPTH:
            raise ValueError("its metadata is nested too deeply")
        fields: dict[int, Any] = {}
        number = 0
        while (first := self._bytes(1)[0]) & 15 != _STOP:
            number = number + (first >> 4) if first >> 4 else self._integer()
            kind = first & 15
            fields[number] = kind == _TRUE if kind in (_TRUE, _FALSE) else self._value(kind, depth)
        return fields

    def _value(self, kind: int, depth: int) -> Any:
        if kind in (_I16, _I32, _I64):
            return self._integer()
        if kind == _BINARY:
            return self._bytes(self._varint())
        if kind == _STRUCT:
            return self.struct(depth + 1)
        if kind in (_LIST, _SET):
            return self._list(depth)
        if kind in (_TRUE, _FALSE, _BYTE):  # true and false in a list have a byte each
            return self._bytes(1)[0]
        if kind == _DOUBLE:
            return self._bytes(8)
        raise ValueError("its metadata holds a field of unknown kind")  # no map is in parquet's

    def _list(self, depth: int) -> list[Any]:
        first = self._bytes(1)[0]
        count = self._varint() if first >> 4 == 15 else first >> 4
        if depth > _DEPTH or count > len(self._data) - self.at:  # every element has a byte
            raise ValueError("its metadata holds a list longer than itself")
        return [self._value(first & 15, depth + 1) for _ in range(count)]

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
        raise ValueError("its metadata holds a number of more than 64 bits")

    def _bytes(self, count: int) -> bytes:
        if count > len(self._data) - self.at:
            raise ValueError("its metadata is cut short")
        self.at += count
        return self._data[self.at - count : self.at]
