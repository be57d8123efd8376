"""Arrow tables in memory, checked as columns are asked for; feather files (Arrow IPC) of them.

The size of a file in memory is known before it is decompressed.
"""

from __future__ import annotations

import mmap
import os
from collections.abc import Iterable, Iterator, Sequence
from contextlib import contextmanager
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
import pyarrow as pa
from numpy.typing import NDArray
from pyarrow import ipc

from recast.core.errors import InputError
from recast.core.files import disk_errors, kind_of_file, read_bytes
from recast.tables.encodings import Buffer, FlatTable, integer

ROW_LIMIT = 1 << 22
"""Rows of a table in memory, at most: a text takes up to 60 bytes beside its characters."""
FEATHER_LIMIT = 1 << 28
"""Bytes of a feather file on disk, and of its buffers in memory, at most."""

_MAGIC = b"ARROW1"
_BLOCK = np.dtype([("offset", "<i8"), ("metadata", "<i4"), ("pad", "<i4"), ("body", "<i8")])
_BUFFER = np.dtype([("offset", "<i8"), ("length", "<i8")])
_CONTINUATION = 0xFFFFFFFF
_DICTIONARY, _BATCH = 2, 3  # of the union MessageHeader


@dataclass(frozen=True)
class ArrowTable:
    """Some columns of a file, validated in full by Arrow.

    Attributes:
        path: the file, for messages.
        mend: what the user can do about any fault in it.
        data: table of at most `ROW_LIMIT` rows; every column is plain (see `require_plain`).
    """

    path: Path
    mend: str
    data: pa.Table

    def __len__(self) -> int:
        """Number of rows."""
        return int(self.data.num_rows)

    def numbers(self, name: str, finite: bool = True) -> NDArray[Any]:
        """A column (N,) of integers or floats, as stored.

        Args:
            finite: refuse NaN and infinity.

        Raises:
            InputError: it holds something else, or a cell is empty or not finite.
        """
        column = self._column(name)
        if not _is_number(column.type):
            raise self._error(f"column {name}", f"holds {_name(column.type)}, not numbers")
        values: NDArray[Any] = column.to_numpy()
        wrong = np.flatnonzero(~np.isfinite(values))
        if finite and len(wrong):
            problem = f"is {values[wrong[0]]}, not a number"
            raise self._error(f"column {name}, row {wrong[0]}", problem)
        return values

    def words(self, name: str) -> NDArray[np.object_]:
        """A column (N,) of str, plain or by dictionary.

        Raises:
            InputError: it holds something else, or a cell is empty.
        """
        column = self._column(name)
        if not _is_text(column.type):
            raise self._error(f"column {name}", f"holds {_name(column.type)}, not text")
        words = np.empty(len(self), np.object_)
        row = 0
        for chunk in column.chunks:
            if pa.types.is_dictionary(chunk.type):  # each text once, however often it is used
                values = np.array([*chunk.dictionary.to_pylist(), None], np.object_)
                found = values[chunk.indices.to_numpy(zero_copy_only=False)]
            else:
                found = chunk.to_pylist()
            words[row : row + len(chunk)] = found
            row += len(chunk)
        empty = [row for row, word in enumerate(words) if word is None]
        if empty:  # empty in the dictionary
            raise self._error(f"column {name}, row {empty[0]}", "is empty")
        return words

    def lists(self, name: str, width: int) -> NDArray[np.float64]:
        """A column of lists of `width` finite numbers each, (N, width).

        Raises:
            InputError: it holds something else, or a cell or a number in it is empty, of another
                length or not finite.
        """
        column = self._column(name)
        if not _is_list(column.type):
            raise self._error(f"column {name}", f"holds {_name(column.type)}, not lists of numbers")
        rows: list[NDArray[np.float64]] = [np.empty((0, width))]
        for chunk in column.chunks:
            lengths = _lengths(chunk)
            wrong = np.flatnonzero(lengths != width)
            if len(wrong):
                where = f"column {name}, row {sum(map(len, rows)) + wrong[0]}"
                raise self._error(where, f"has {lengths[wrong[0]]} numbers, not {width}")
            flat = chunk.flatten().to_numpy(zero_copy_only=False)  # an empty one becomes NaN
            rows.append(flat.astype(np.float64).reshape(len(chunk), width))
        values = np.concatenate(rows)
        wrong = np.flatnonzero(~np.isfinite(values).all(axis=1))
        if len(wrong):
            raise self._error(f"column {name}, row {wrong[0]}", "holds NaN or infinity")
        return values

    def _column(self, name: str) -> pa.ChunkedArray:
        column = self.data[name]
        if column.null_count:
            row = column.is_null().to_pylist().index(True)
            raise self._error(f"column {name}, row {row}", "is empty")
        return column

    def _error(self, field: str, problem: str) -> InputError:
        return InputError(self.path, field, problem, self.mend)


def require_plain(path: Path, schema: pa.Schema, columns: Iterable[str], mend: str) -> None:
    """Only types whose size in memory is known: numbers, text, bytes, and lists of numbers.

    Raises:
        InputError: a column is missing, there twice, or of another type.
    """
    for name in columns:
        indices = schema.get_all_field_indices(name)
        if len(indices) != 1:
            problem = "occurs twice" if indices else "is missing"
            raise InputError(path, f"column {name}", problem, mend)
        kind = schema.field(indices[0]).type
        plain = _is_number(kind) or _is_text(kind) or _is_bytes(kind) or _is_list(kind)
        if not plain and not pa.types.is_boolean(kind) and not pa.types.is_null(kind):
            problem = f"holds {_name(kind)}, not numbers, text, bytes or lists of numbers"
            raise InputError(path, f"column {name}", problem, mend)


@contextmanager
def arrow_errors(path: Path, field: str, mend: str) -> Iterator[None]:
    """Turn whatever Arrow raises on damaged bytes into one line that names the file.

    Raises:
        InputError: in place of any other error.
    """
    try:
        with disk_errors(path):
            yield
    except InputError:
        raise
    except Exception as error:  # Arrow's own, and MemoryError, UnicodeDecodeError, SystemError, ...
        reason = " ".join(str(error).split()) or type(error).__name__
        with path.open("rb") as stream:
            kind = kind_of_file(stream.read(512))
        # Damaged files of the right kind begin like whole ones.
        wanted = field.split()[0]
        if kind and wanted in ("feather", "Arrow", "parquet") and wanted not in kind:
            reason = f"the file is {kind}"
        raise InputError(path, field, f"cannot be read ({reason})", mend) from None


def _lengths(chunk: pa.Array) -> NDArray[np.int64]:
    if pa.types.is_fixed_size_list(chunk.type):
        return np.full(len(chunk), chunk.type.list_size)
    return np.diff(chunk.offsets.to_numpy()).astype(np.int64)


def _is_number(kind: pa.DataType) -> bool:
    return bool(pa.types.is_integer(kind) or pa.types.is_floating(kind))


def _is_text(kind: pa.DataType) -> bool:
    if pa.types.is_dictionary(kind):
        kind = kind.value_type
    return bool(pa.types.is_string(kind) or pa.types.is_large_string(kind))


def _is_bytes(kind: pa.DataType) -> bool:
    return bool(pa.types.is_binary(kind) or pa.types.is_large_binary(kind))


def _is_list(kind: pa.DataType) -> bool:
    lists = (pa.types.is_list, pa.types.is_large_list, pa.types.is_fixed_size_list)
    return any(of(kind) for of in lists) and _is_number(kind.value_type)


def _name(kind: pa.DataType) -> str:
    # Names of nested types may be as long as the file.
    text = str(kind)
    return text if len(text) <= 40 else text[:37] + "..."


def read_feather(path: Path, columns: Sequence[str], mend: str) -> ArrowTable:
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
    return ArrowTable(path, mend, table)


def check_batches(path: Path, mend: str, limit: int) -> None:
    """Check an Arrow file of any size that a library reads batch by batch, without checks.

    Args:
        limit: bytes that a batch may take in memory.

    Raises:
        InputError: it is damaged, or a batch is larger.
    """
    with arrow_errors(path, "Arrow file", mend), path.open("rb") as stream:
        if stream.read(len(_MAGIC)) != _MAGIC:
            raise ValueError("is not an Arrow file")
        with mmap.mmap(stream.fileno(), 0, access=mmap.ACCESS_READ) as data:
            largest = max((size for _, size in _batch_sizes(data)), default=0)
        if largest > limit:
            raise InputError(path, "Arrow file", f"a batch claims {largest} bytes", mend)
        with pa.memory_map(os.fsencode(path)) as source:
            reader = ipc.open_file(source, options=ipc.IpcReadOptions(use_threads=False))
            for i in range(reader.num_record_batches):
                reader.get_batch(i).validate(full=True)


def declared_size(data: Buffer) -> tuple[int, int]:
    """Rows of an Arrow IPC file, and bytes that its buffers take once decompressed.

    Arrow takes the memory that a compressed buffer claims for itself before it decompresses it.

    Raises:
        ValueError: it is no such file, or a part of its metadata points outside of it.
    """
    rows, sizes = zip((0, 0), *_batch_sizes(data), strict=True)
    return sum(rows), sum(sizes)


def _batch_sizes(data: Buffer) -> Iterator[tuple[int, int]]:
    """Rows (0 for a dictionary) and decompressed bytes of each message."""
    if data[:4] == b"FEA1":
        raise ValueError("feather version 1; write it again as version 2")
    if data[: len(_MAGIC)] != _MAGIC or data[-len(_MAGIC) :] != _MAGIC:
        raise ValueError("is not an Arrow file, or is truncated")
    end = len(data) - len(_MAGIC) - 4
    length = integer(data, end, 4)
    if not 0 < length <= end - 8:
        raise ValueError("the footer is longer than the file")
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
        raise ValueError("a block lies outside of the file")
    if integer(data, start, 4, signed=False) != _CONTINUATION:
        raise ValueError("a message without its marker; write the file again")
    message = FlatTable.root(data[start + 8 : body])
    header = message.table(2)
    if header is None or message.integer(1, 1) != kind or message.integer(3, 8) != length:
        raise ValueError("a message is of another kind or size than the footer says")
    batch = header.table(1) if kind == _DICTIONARY else header
    if batch is None or batch.integer(0, 8) < 0:
        raise ValueError("a message without rows")
    return batch, body, body + length


def _buffer_sizes(batch: FlatTable, data: Buffer, start: int, stop: int) -> Iterator[int]:
    compressed = batch.table(3) is not None
    for offset, length in batch.structs(2, _BUFFER).tolist():
        at = start + offset
        if offset < 0 or length < 0 or at + length > stop:
            raise ValueError("a buffer lies outside of its message")
        # A compressed buffer begins with its size in memory; -1 says that it is stored as it is.
        claimed = integer(data, at, 8) if compressed and length else -1
        if claimed < -1:
            raise ValueError("a buffer of negative size")
        yield length if claimed == -1 else claimed
