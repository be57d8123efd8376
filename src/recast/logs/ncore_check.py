"""Checks of a store file before it is handed to NCore, which trusts it.

A store is a tar file of zarr arrays with a compressed index at its end. Zarr allocates whatever
shape is written there, fills in chunks that are missing, and decodes with whatever codec is named;
numcodecs has one of Python's pickle, which runs code, and only new versions of it refuse that. So
index and metadata are read here first.
"""

from __future__ import annotations

import lzma
import math
import re
import struct
from collections.abc import Mapping
from pathlib import Path
from typing import Any, BinaryIO

import cbor2
import numpy as np

from recast.storage import disk_errors

BLOCK = 512  # bytes; the last one begins with the header
HEADER = struct.Struct("<4sIQI")  # magic, type, offset and size of the index
BLOSC = struct.Struct("<4xI4xI")  # of its header: bytes unpacked and packed
METADATA = ".zmetadata.cbor.xz"
INDEX_LIMIT = 1 << 28
"""Bytes of index and of metadata, unpacked: a drive of hours has less."""
UNPACKING_MEMORY = 1 << 26
"""Bytes that unpacking may take beside that; what is written takes 9 MB."""
ARRAY_LIMIT = 1 << 28
"""Bytes of one array: an encoded image, or one quantity of the points of a sweep."""
_RATIO = 256  # LZ4 packs no better than 255 to 1
_DTYPE = re.compile(r"[<>|]([biuf][1248]|S[1-9]\d{0,9})")


def check_store(path: Path) -> None:
    """Check index and metadata of a store file; arrays themselves are not read.

    Raises:
        InputError: the disk refuses (see `storage.disk_errors`).
        ValueError: anything in it is not as NCore writes it. Damaged files also raise what lzma and
            cbor2 raise.
    """
    with disk_errors(path), path.open("rb") as file:
        records = _index(file, path.stat().st_size)
        offset, size = records[METADATA]
        file.seek(offset)
        document = _unpacked(file.read(size))
        metadata = document.get("metadata") if isinstance(document, dict) else None
        if not isinstance(metadata, dict) or not all(
            isinstance(v, dict) for v in metadata.values()
        ):
            raise ValueError("its metadata are no object of objects")
        for key, array in metadata.items():
            if key.endswith(".zarray"):
                _check_array(file, key.removesuffix(".zarray"), array, records)


def _index(file: BinaryIO, size: int) -> dict[str, tuple[int, int]]:
    """Offset and size of every member of the tar file, by name."""
    if size < BLOCK:
        raise ValueError("is too short")
    file.seek(size - BLOCK)
    magic, kind, offset, packed = HEADER.unpack(file.read(HEADER.size))
    if (magic, kind) != (b"itar", 1) or offset + packed > size:
        raise ValueError("does not end with an index: it was cut off, or is another kind of file")
    file.seek(offset)
    table = _unpacked(file.read(packed))
    names, offsets, sizes = (table[key] for key in ("items", "offset_datas", "sizes"))
    if not len(names) == len(offsets) == len(sizes) or len(set(names)) != len(names):
        raise ValueError("its index is inconsistent")
    for begin, length in zip(offsets, sizes, strict=True):
        if not (type(begin) is type(length) is int and begin >= 0 <= length):
            raise ValueError("its index is inconsistent")
        if begin + length > size:
            raise ValueError("its index leads beyond its end")
    return dict(zip(names, zip(offsets, sizes, strict=True), strict=True))


def _unpacked(data: bytes) -> Any:
    unpacker = lzma.LZMADecompressor(memlimit=UNPACKING_MEMORY)
    raw = unpacker.decompress(data, max_length=INDEX_LIMIT)
    if not unpacker.eof:
        raise ValueError(f"its index is cut off, or unpacks to more than {INDEX_LIMIT} bytes")
    return cbor2.loads(raw)


def _check_array(
    file: BinaryIO,
    name: str,
    array: Mapping[str, Any],
    records: Mapping[str, tuple[int, int]],
) -> None:
    """Check that an array is of plain numbers or bytes, whole in one chunk, and of bounded size."""
    dtype, shape, codec = array["dtype"], array["shape"], array["compressor"]
    if not (isinstance(dtype, str) and _DTYPE.fullmatch(dtype)):
        raise ValueError(f"array {name} has type {dtype!r}")
    if array["filters"] or not (codec is None or codec["id"] == "blosc"):
        raise ValueError(f"array {name} is encoded as {codec!r}, {array['filters']!r}")
    if not all(type(n) is int and n >= 0 for n in shape) or len(shape) > 4:
        raise ValueError(f"array {name} has shape {shape!r}")
    if list(array["chunks"]) != [max(n, 1) for n in shape]:
        raise ValueError(f"array {name} is not in one piece")
    size = np.dtype(dtype).itemsize * math.prod(shape)
    offset, stored = records.get(name + (".".join("0" * len(shape)) or "0"), (0, 0))
    unpacked = stored
    if codec is not None and stored >= BLOSC.size:
        file.seek(offset)
        unpacked, packed = BLOSC.unpack(file.read(BLOSC.size))
        unpacked = unpacked if packed == stored else -1
    if size != unpacked or size > min(ARRAY_LIMIT, _RATIO * stored):
        raise ValueError(f"array {name} of {size} bytes does not match its {stored} stored ones")
