"""TFRecord files: framed, checksummed records, read one at a time.

Framing: length as 8 bytes little-endian, its masked CRC-32C in 4, the data, their masked CRC-32C.
Source of CRC-32C (Castagnoli): RFC 3720, appendix B.4: reflected polynomial 0x82F63B78, register
and result inverted. `crc32c` is fast enough for records of 100 MB; `crc32c_reference` says what it
computes.
"""

from __future__ import annotations

import struct
from collections.abc import Iterator
from dataclasses import dataclass
from functools import cache
from pathlib import Path
from typing import BinaryIO

import numpy as np
from numpy.typing import NDArray

from recast.core.errors import InputError

Words = NDArray[np.uint32]

POLYNOMIAL = 0x82F63B78
LANES = 4096
_STEP = 8
"""Bytes that every lane takes in one step."""
HEADER = struct.Struct("<QI")
FOOTER = struct.Struct("<I")
_MASK = 0xA282EAD8
_MEND = "download it again"


@dataclass(frozen=True)
class Record:
    """One record.

    Attributes:
        number: counted from 0.
        offset: of the data in the file, bytes.
        data: as stored.
    """

    number: int
    offset: int
    data: bytes


def masked_crc(data: bytes) -> int:
    """The checksum as stored: rotated and offset, so that checksums of checksums are harmless."""
    crc = crc32c(data)
    return (((crc >> 15) | (crc << 17)) + _MASK) & 0xFFFFFFFF


def read_records(path: Path) -> Iterator[Record]:
    """All records of a file in order, both checksums of each compared.

    Raises:
        InputError: no such file, not a TFRecord, a record cut off or damaged, or none at all.
    """
    if not path.is_file():
        raise InputError(path, "TFRecord file", "does not exist", "check the path")
    size, number = path.stat().st_size, 0
    if size == 0:
        raise InputError(path, "record 0", "is missing: the file is empty", _MEND)
    with path.open("rb") as file:
        while file.tell() < size:
            yield _read_record(path, file, size, number)
            number += 1


def _read_record(path: Path, file: BinaryIO, size: int, number: int) -> Record:
    header = file.read(HEADER.size)
    where = f"record {number}"
    if len(header) < HEADER.size:
        raise InputError(path, f"{where}, length", "is cut off", _MEND)
    length, length_crc = HEADER.unpack(header)
    if masked_crc(header[:8]) != length_crc:
        if number == 0:
            problem, mend = "this is no (uncompressed) TFRecord file", "name a .tfrecord file"
        else:
            problem, mend = "does not fit its checksum", _MEND
        raise InputError(path, f"{where}, length", problem, mend)
    offset = file.tell()
    missing = length + FOOTER.size - (size - offset)
    if missing > 0:
        raise InputError(path, f"{where}, data", f"are cut off, {missing} bytes are missing", _MEND)
    data = file.read(length)
    if masked_crc(data) != FOOTER.unpack(file.read(FOOTER.size))[0]:
        raise InputError(path, f"{where}, data", "do not fit their checksum", _MEND)
    return Record(number, offset, data)


def crc32c_reference(data: bytes | memoryview) -> int:
    """CRC-32C of `data`, byte by byte."""
    table = _byte_tables()[0].tolist()
    register = 0xFFFFFFFF
    for byte in data:
        register = table[(register ^ byte) & 0xFF] ^ (register >> 8)
    return register ^ 0xFFFFFFFF


def crc32c(data: bytes | memoryview) -> int:
    """CRC-32C of `data`; the same as `crc32c_reference`.

    The checksum is linear over bits: the data are cut into lanes which advance side by side, each
    from an empty register, and pairs of lanes are joined, the left one moved on by as many zero
    bytes as the right one is long. Zeros before the data change nothing, and a full register at the
    start is the same as the first four bytes inverted.
    """
    if len(data) < LANES * _STEP:
        return crc32c_reference(data)
    columns = -(-len(data) // (LANES * _STEP))
    padded = np.zeros(LANES * _STEP * columns, np.uint8)
    begin = len(padded) - len(data)
    padded[begin:] = np.frombuffer(data, np.uint8)
    padded[begin : begin + 4] ^= 0xFF
    # One row for each step, so that the lanes of a step lie together in memory.
    steps = np.ascontiguousarray(padded.view("<u8").reshape(LANES, columns).T)
    tables = _half_word_tables()
    state = np.zeros(LANES, np.uint32)
    for step in steps:
        halves = step.view("<u2").reshape(LANES, 4).T
        low, high, third, fourth = halves.astype(np.intp)  # numpy indexes twice as fast with these
        state = (
            tables[3][low ^ (state & 0xFFFF)]
            ^ tables[2][high ^ (state >> 16)]
            ^ tables[1][third]
            ^ tables[0][fourth]
        )
    length = _STEP * columns
    while len(state) > 1:
        state = _apply(_zeros(length), state[0::2]) ^ state[1::2]
        length *= 2
    return int(state[0]) ^ 0xFFFFFFFF


@cache
def _byte_tables() -> Words:
    """(256,) and on: registers after a byte b and after i zero bytes behind it, (8, 256)."""
    first = np.arange(256, dtype=np.uint32)
    for _ in range(8):
        first = np.where(first & 1, (first >> 1) ^ np.uint32(POLYNOMIAL), first >> 1)
    tables = [first]
    for _ in range(7):
        tables.append(first[tables[-1] & 0xFF] ^ (tables[-1] >> 8))
    return np.stack(tables)


@cache
def _half_word_tables() -> Words:
    """Registers after two bytes and 2 i zero bytes behind them, (4, 65536)."""
    both = np.arange(65536)
    low, high = both & 0xFF, both >> 8
    tables = _byte_tables()
    return np.stack([tables[2 * i + 1][low] ^ tables[2 * i][high] for i in range(4)])


@cache
def _zeros(length: int) -> Words:
    """What `length` zero bytes make of each bit of the register, (32,)."""
    if length == 1:
        bits = np.uint32(1) << np.arange(32, dtype=np.uint32)
        moved: Words = _byte_tables()[0][bits & 0xFF] ^ (bits >> 8)
        return moved
    half = _zeros(length // 2)
    moved = _apply(half, half)
    return moved if length % 2 == 0 else _apply(_zeros(1), moved)


def _apply(images_of_bits: Words, registers: Words) -> Words:
    """A linear map, given by its images of the 32 bits, of registers (N,)."""
    moved = np.zeros_like(registers)
    for bit, image in enumerate(images_of_bits):
        moved ^= np.where((registers >> np.uint32(bit)) & 1, image, np.uint32(0))
    return moved
