"""TFRecord files: framed, checksummed records, read one at a time.

Framing: length as 8 bytes little-endian, its masked CRC-32C in 4, the data, their masked CRC-32C.
"""

from __future__ import annotations

import struct
from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path
from typing import BinaryIO

from recast.errors import InputError
from recast.logs.importers.waymo_crc32c import crc32c

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
