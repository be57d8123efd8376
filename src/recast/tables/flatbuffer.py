"""Tables of FlatBuffers, the encoding of Arrow's metadata, read within their bounds.

Layout: https://flatbuffers.dev/internals. All numbers are little-endian; a table begins with the
distance back to its vtable, which holds the place of each field, 0 where the default is meant.
"""

from __future__ import annotations

from dataclasses import dataclass
from mmap import mmap

import numpy as np
from numpy.typing import NDArray

Buffer = bytes | mmap
"""Bytes of a file."""


class DamagedError(ValueError):
    """A number or an offset in the bytes leads out of them, or is impossible."""


def integer(data: Buffer, at: int, size: int, signed: bool = True) -> int:
    """The integer of `size` bytes at `at`.

    Raises:
        DamagedError: it lies outside of `data`.
    """
    if at < 0 or at + size > len(data):
        raise DamagedError("an offset leads out of the metadata")
    return int.from_bytes(data[at : at + size], "little", signed=signed)


@dataclass(frozen=True)
class FlatTable:
    """One table.

    Attributes:
        data: the whole FlatBuffer.
        at: where the table begins.
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
            DamagedError: see `integer`.
        """
        place = self._place(slot)
        return 0 if place is None else integer(self.data, place, size)

    def table(self, slot: int) -> FlatTable | None:
        """The table that field `slot` refers to.

        Raises:
            DamagedError: see `integer`.
        """
        place = self._target(slot)
        return None if place is None else FlatTable(self.data, place)

    def structs(self, slot: int, layout: np.dtype[np.void]) -> NDArray[np.void]:
        """The vector of structs (N,) in field `slot`.

        Raises:
            DamagedError: it is longer than the bytes.
        """
        place = self._target(slot)
        if place is None:
            return np.empty(0, layout)
        count = integer(self.data, place, 4, signed=False)
        if place + 4 + count * layout.itemsize > len(self.data):
            raise DamagedError("a list is longer than the metadata")
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
