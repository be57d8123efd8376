"""Protocol buffers and TFRecord files, written byte by byte, so that tests can write them wrong."""

from __future__ import annotations

import struct
from collections.abc import Iterable
from pathlib import Path

import google_crc32c


def varint(value: int) -> bytes:
    """Seven bits a byte, the lowest first; negative as two's complement of 64 bits."""
    value %= 1 << 64
    out = bytearray()
    while value >= 0x80:
        out.append(value & 0x7F | 0x80)
        value >>= 7
    return bytes([*out, value])


def integer(number: int, value: int) -> bytes:
    return varint(number << 3) + varint(value)


def double(number: int, value: float) -> bytes:
    return varint(number << 3 | 1) + struct.pack("<d", value)


def single(number: int, value: float) -> bytes:
    return varint(number << 3 | 5) + struct.pack("<f", value)


def blob(number: int, value: bytes | str) -> bytes:
    """A string, bytes or a message."""
    data = value.encode() if isinstance(value, str) else value
    return varint(number << 3 | 2) + varint(len(data)) + data


def doubles(number: int, values: Iterable[float]) -> bytes:
    """Repeated, each with its key."""
    return b"".join(double(number, value) for value in values)


def packed_doubles(number: int, values: Iterable[float]) -> bytes:
    return blob(number, b"".join(struct.pack("<d", value) for value in values))


def packed_integers(number: int, values: Iterable[int]) -> bytes:
    return blob(number, b"".join(varint(value) for value in values))


def masked(data: bytes) -> int:
    crc = google_crc32c.value(data)
    return ((crc >> 15 | crc << 17 & 0xFFFFFFFF) + 0xA282EAD8) % (1 << 32)


def record_header(size: int) -> bytes:
    """What comes before the data of a record."""
    length = struct.pack("<Q", size)
    return length + struct.pack("<I", masked(length))


def frame_record(data: bytes) -> bytes:
    """One record of a TFRecord file."""
    return record_header(len(data)) + data + struct.pack("<I", masked(data))


def write_records(path: Path, records: Iterable[bytes]) -> None:
    path.parent.mkdir(parents=True, exist_ok=True)
    path.write_bytes(b"".join(frame_record(record) for record in records))
