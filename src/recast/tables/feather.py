"""Feather files (Arrow IPC), whose size in memory is known before they are decompressed."""

from __future__ import annotations

import mmap
from collections.abc import Iterator, Sequence
from pathlib import Path

import numpy as np
import pyarrow as pa
from pyarrow import ipc

from recast.errors import InputError
from recast.storage import read_bytes
from recast.tables.columns import ROW_LIMIT, Table, arrow_errors, require_plain
from recast.tables.flatbuffer import Buffer, DamagedError, FlatTable, integer

FEATHER_LIMIT = 1 << 28
"""Bytes of a feather file on disk, and of its buffers in memory, at most."""

_MAGIC = b"ARROW1"
_BLOCK = np.dtype([("offset", "<i8"), ("metadata", "<i4"), ("pad", "<i4"), ("body", "<i8")])
_BUFFER = np.dtype([("offset", "<i8"), ("length", "<i8")])
_CONTINUATION = 0xFFFFFFFF
_DICTIONARY, _BATCH = 2, 3  # of the union MessageHeader


def read_feather(path: Path, columns: Sequence[str], mend: str) -> Table:
    """Columns of a feather file of version 2; others that it has are not decoded.

    Args:
        mend: what the user can do about any fault.

    Raises:
        InputError: the file is missing, damaged, larger than `FEATHER_LIMIT` on disk or in memory,
            has more than `ROW_LIMIT` rows, or a column is missing or of no plain type.
    """
    path = Path(path)
    if not path.is_file():
        raise InputError(path, "file", "is missing", mend)
    data = read_bytes(path, FEATHER_LIMIT)
    with arrow_errors(path, "feather table", mend):
        rows, size = declared_size(data)
        if rows > ROW_LIMIT or size > FEATHER_LIMIT:
            problem = (
                f"claims {rows} rows and {size} bytes, {ROW_LIMIT} and {FEATHER_LIMIT} at most"
            )
            raise InputError(path, "feather table", problem, mend)
        buffer = pa.BufferReader(data)
        schema = ipc.open_file(buffer).schema
        require_plain(path, schema, columns, mend)
        wanted = sorted(schema.get_field_index(name) for name in columns)
        options = ipc.IpcReadOptions(use_threads=False, included_fields=wanted)
        table = ipc.open_file(buffer, options=options).read_all()
        table.validate(full=True)
    return Table(path, mend, table)


def check_batches(path: Path, mend: str, limit: int) -> None:
    """Check an Arrow file of any size that a library reads batch by batch, without checks.

    Args:
        limit: bytes that a batch may take in memory.

    Raises:
        InputError: it is damaged, or a batch is larger.
    """
    with arrow_errors(path, "Arrow file", mend), path.open("rb") as stream:
        if stream.read(len(_MAGIC)) != _MAGIC:
            raise DamagedError("no Arrow file")
        with mmap.mmap(stream.fileno(), 0, access=mmap.ACCESS_READ) as data:
            largest = max((size for _, size in _batch_sizes(data)), default=0)
        if largest > limit:
            raise InputError(path, "Arrow file", f"a batch claims {largest} bytes", mend)
        with pa.memory_map(str(path)) as source:
            reader = ipc.open_file(source, options=ipc.IpcReadOptions(use_threads=False))
            for i in range(reader.num_record_batches):
                reader.get_batch(i).validate(full=True)


def declared_size(data: Buffer) -> tuple[int, int]:
    """Rows of an Arrow IPC file, and bytes that its buffers take once decompressed.

    Arrow takes the memory that a compressed buffer claims for itself before it decompresses it.

    Raises:
        DamagedError: it is no such file, or a part of its metadata points outside of it.
    """
    rows, sizes = zip((0, 0), *_batch_sizes(data), strict=True)
    return sum(rows), sum(sizes)


def _batch_sizes(data: Buffer) -> Iterator[tuple[int, int]]:
    """Rows (0 for a dictionary) and decompressed bytes of each message."""
    if data[:4] == b"FEA1":
        raise DamagedError("feather version 1; write it anew as version 2")
    if data[: len(_MAGIC)] != _MAGIC or data[-len(_MAGIC) :] != _MAGIC:
        raise DamagedError("no Arrow file, or cut short")
    end = len(data) - len(_MAGIC) - 4
    length = integer(data, end, 4)
    if not 0 < length <= end - 8:
        raise DamagedError("the footer is longer than the file")
    footer = FlatTable.root(data[end - length : end])
    for slot, kind in ((2, _DICTIONARY), (3, _BATCH)):
        for block in footer.structs(slot, _BLOCK):
            batch, start, stop = _batch(data, block, kind)
            rows = batch.integer(0, 8) if kind == _BATCH else 0
            yield rows, sum(_buffer_sizes(batch, data, start, stop))


def _batch(data: Buffer, block: np.void, kind: int) -> tuple[FlatTable, int, int]:
    """The RecordBatch of a message, and where its buffers begin and end."""
    start, metadata, length = (int(block[name]) for name in ("offset", "metadata", "body"))
    body = start + metadata
    if start < 0 or metadata < 8 or length < 0 or body + length > len(data):
        raise DamagedError("a block lies outside of the file")
    if integer(data, start, 4, signed=False) != _CONTINUATION:
        raise DamagedError("a message without its marker; write it anew")
    message = FlatTable.root(data[start + 8 : body])
    header = message.table(2)
    if header is None or message.integer(1, 1) != kind or message.integer(3, 8) != length:
        raise DamagedError("a message is of another kind or size than the footer says")
    batch = header.table(1) if kind == _DICTIONARY else header
    if batch is None or batch.integer(0, 8) < 0:
        raise DamagedError("a message without rows")
    return batch, body, body + length


def _buffer_sizes(batch: FlatTable, data: Buffer, start: int, stop: int) -> Iterator[int]:
    compressed = batch.table(3) is not None
    for offset, length in batch.structs(2, _BUFFER).tolist():
        at = start + offset
        if offset < 0 or length < 0 or at + length > stop:
            raise DamagedError("a buffer lies outside of its message")
        # A compressed buffer begins with its size in memory; -1 says that it is stored as it is.
        claimed = integer(data, at, 8) if compressed and length else -1
        if claimed < -1:
            raise DamagedError("a buffer of negative size")
        yield length if claimed == -1 else claimed
