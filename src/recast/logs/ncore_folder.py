"""The NCore V4 stores of a log folder, checked and opened.

The files are foreign, and NCore trusts them. A store is a tar file of zarr arrays with a compressed
index at its end. Zarr allocates whatever shape is written there, fills in chunks that are missing,
and decodes with whatever codec is named; numcodecs has one of Python's pickle, which runs code, and
only new versions of it refuse that. So index and metadata are read here first, and what NCore and
the libraries below it raise for the rest becomes one line.
"""

from __future__ import annotations

import functools
import lzma
import math
import os
import re
import struct
from collections.abc import Hashable, Iterator, Mapping
from contextlib import contextmanager
from dataclasses import dataclass
from pathlib import Path
from typing import Any, BinaryIO, TypeVar, cast

import cbor2
import numpy as np
from ncore.data.v4 import SequenceComponentGroupsReader

from recast.core import files, names
from recast.core.errors import InputError
from recast.core.files import disk_errors
from recast.logs.ncore_write import SEQUENCE_FILE

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
Reader = TypeVar("Reader")
MEND = "import the drive again"


@contextmanager
def readable(path: Path, field: str) -> Iterator[None]:
    """Turn whatever goes wrong with a store's contents inside the block into one clear line."""
    try:
        yield
    except InputError:
        raise
    except (
        Exception
    ) as error:  # zarr, cbor, lzma, Blosc, numpy and NCore each raise their own kinds
        reason = str(error) or type(error).__name__
        raise InputError(path, field, f"cannot be read ({reason})", MEND) from error


@dataclass(frozen=True)
class NcoreFolder:
    """An NCore V4 store in a folder; cheap to copy into another process.

    Attributes:
        folder: folder that holds ncore.json and the stores it lists.
    """

    folder: Path

    @property
    def listing(self) -> Path:
        """The file that names the stores."""
        return self.folder / SEQUENCE_FILE

    def check(self) -> None:
        """Open every store.

        Raises:
            InputError: ncore.json or a store it lists is missing or broken.
        """
        self._open()

    def has(self, kind: type[Any], name: str) -> bool:
        """Whether there is a component of this kind and instance name."""
        return name in _open_components(self._open(), cast(Hashable, kind))

    def component(self, kind: type[Reader], name: str) -> Reader:
        """The component reader of this kind and instance name.

        Raises:
            InputError: there is none.
        """
        field = f"{kind.__qualname__.split('.')[0]} {name!r}"
        with readable(self.listing, field):
            components = _open_components(self._open(), cast(Hashable, kind))
        if name not in components:
            raise InputError(self.listing, field, "is missing from the stores", MEND)
        return cast(Reader, components[name])

    def _open(self) -> SequenceComponentGroupsReader:
        with files.disk_errors(self.listing):
            status = self.listing.stat()
        # Open files cannot be shared with a forked process, nor with a folder written anew.
        return _open(self.folder, os.getpid(), status.st_ino, status.st_mtime_ns)


@functools.lru_cache(maxsize=4)
def _open(folder: Path, pid: int, inode: int, changed: int) -> SequenceComponentGroupsReader:
    listing = folder / SEQUENCE_FILE
    field = "component_stores"
    with readable(listing, field):
        listed = [store["path"] for store in files.read_json(listing)[field]]
    if not listed or not all(isinstance(name, str) for name in listed):
        raise InputError(listing, field, "lists no files", MEND)
    if len(set(listed)) != len(listed):
        raise InputError(listing, field, "lists a store twice", MEND)
    paths = [names.member(folder, name, listing, field) for name in listed]
    for path in paths:
        with readable(path, "NCore store"):
            check_store(path)
    with readable(listing, "NCore stores"):
        return SequenceComponentGroupsReader(paths, max_threads=1)


@functools.lru_cache(maxsize=64)
def _open_components(reader: SequenceComponentGroupsReader, kind: Hashable) -> dict[str, Any]:
    return dict(reader.open_component_readers(cast(Any, kind)))


def check_store(path: Path) -> None:
    """Check index and metadata of a store file; arrays themselves are not read.

    Raises:
        InputError: the disk refuses (see `files.disk_errors`).
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
            raise ValueError("its metadata is not an object of objects")
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
        raise ValueError(f"array {name} is not stored in one piece")
    size = np.dtype(dtype).itemsize * math.prod(shape)
    offset, stored = records.get(name + (".".join("0" * len(shape)) or "0"), (0, 0))
    unpacked = stored
    if codec is not None and stored >= BLOSC.size:
        file.seek(offset)
        unpacked, packed = BLOSC.unpack(file.read(BLOSC.size))
        unpacked = unpacked if packed == stored else -1
    if size != unpacked or size > min(ARRAY_LIMIT, _RATIO * stored):
        raise ValueError(f"array {name} of {size} bytes does not match its {stored} stored ones")
