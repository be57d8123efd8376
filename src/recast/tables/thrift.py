"""Thrift's compact encoding, the one of Parquet's metadata, read within its bounds.

Layout: https://github.com/apache/thrift/blob/master/doc/specs/thrift-compact-protocol.md
"""

from __future__ import annotations

from typing import Any

_STOP, _TRUE, _FALSE, _BYTE, _I16, _I32, _I64, _DOUBLE, _BINARY, _LIST, _SET, _MAP, _STRUCT = range(
    13
)
_DEPTH = 16


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
