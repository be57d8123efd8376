"""Tables and arrays of foreign files: parquet and feather by pyarrow, .npy and .npz by NumPy.

`read_feather` and `read_parquet` return an `ArrowTable`, whose methods check a column when it is
asked for; `ParquetRows` streams a parquet file that is too large for memory; `check_batches` checks
an Arrow file that another library is about to read. For each of them holds:

- Rows and bytes in memory are compared with a limit after each batch, rows of parquet before.
- Every decoded batch is validated in full: offsets, lengths, dictionary indices and UTF-8.
- Whatever Arrow raises is one `InputError` that names the file.

Metadata of a column chunk (`RowGroupMetaData.column`) is never asked for: pyarrow ends the process
on damage there that its reader only refuses.

Pickled objects of arrays are never loaded.
"""

from __future__ import annotations

import io
import os
import zipfile
from collections.abc import Iterable, Iterator, Sequence
from contextlib import contextmanager
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
import pyarrow as pa
import pyarrow.parquet as pq
from numpy.typing import NDArray
from pyarrow import ipc

from recast.core.errors import InputError
from recast.core.files import atomic_file, disk_errors, kind_of_file, read_bytes

ROW_LIMIT = 1 << 22
"""Rows of a table in memory, at most: a text takes up to 60 bytes beside its characters."""
TABLE_LIMIT = 1 << 28
"""Bytes of a table that is read as a whole, at most: of a feather file, and in memory."""
STREAM_LIMIT = 1 << 32
"""Bytes in memory of a batch while a parquet file is read piece by piece, at most."""
_ROWS_AT_ONCE = 1024
_FEATHER = "a feather file (Arrow)"
_KINDS = {"parquet": "a parquet file", "feather": _FEATHER, "Arrow": _FEATHER}
"""What `kind_of_file` says of whole files; damaged ones of the right kind begin like them."""


@dataclass(frozen=True)
class ArrowTable:
    """Some columns of a file, validated in full by Arrow.

    Attributes:
        path: the file, for messages.
        mend: what the user can do about any fault in it.
        data: table of at most `ROW_LIMIT` rows; every column is plain (see `_require_plain`).
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


def _require_plain(path: Path, schema: pa.Schema, columns: Iterable[str], mend: str) -> None:
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
def _arrow_errors(path: Path, field: str, mend: str) -> Iterator[None]:
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
        if kind and kind != _KINDS.get(field.split()[0], kind):
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
        InputError: the file is missing, damaged, larger than `TABLE_LIMIT` on disk or in memory,
            has more than `ROW_LIMIT` rows, or a column is missing or of no plain type.
    """
    path, field = Path(path), "feather table"
    if not path.is_file():
        raise InputError(path, "file", "is missing", mend)
    data = read_bytes(path, TABLE_LIMIT)
    with _arrow_errors(path, field, mend):
        buffer = pa.BufferReader(data)
        schema = ipc.open_file(buffer).schema
        _require_plain(path, schema, columns, mend)
        wanted = sorted(schema.get_field_index(name) for name in columns)
        options = ipc.IpcReadOptions(use_threads=False, included_fields=wanted)
        reader = ipc.open_file(buffer, options=options)
        return _whole(path, field, mend, reader.schema, _batches(reader))


def _batches(reader: ipc.RecordBatchFileReader) -> Iterator[pa.RecordBatch]:
    for index in range(reader.num_record_batches):
        batch = reader.get_batch(index)
        batch.validate(full=True)
        yield batch


def read_parquet(path: Path, columns: Sequence[str], mend: str) -> ArrowTable:
    """Columns of a parquet file; others that it has are not decoded.

    Args:
        mend: what the user can do about any fault.

    Raises:
        InputError: the file is missing or damaged, has more than `ROW_LIMIT` rows, takes more than
            `TABLE_LIMIT` bytes in memory, or a column is missing or of no plain type.
    """
    rows = ParquetRows(path, columns, mend)
    field, count = "parquet table", int(rows.first_rows[-1])
    if count > ROW_LIMIT:
        raise InputError(path, field, f"has {count} rows, {ROW_LIMIT} are read at most", mend)
    batches = (
        batch
        for group in range(len(rows.first_rows) - 1)
        for batch in rows.batches(group, rows_at_once=ROW_LIMIT)
    )
    return _whole(Path(path), field, mend, rows.schema, batches)


def _whole(
    path: Path, field: str, mend: str, schema: pa.Schema, batches: Iterable[pa.RecordBatch]
) -> ArrowTable:
    """A table of all batches, each checked before the next is decoded."""
    kept, rows, size = [], 0, 0
    for batch in batches:
        rows, size = rows + batch.num_rows, size + batch.nbytes
        if rows > ROW_LIMIT or size > TABLE_LIMIT:
            problem = f"has over {ROW_LIMIT} rows, or over {TABLE_LIMIT} bytes in memory"
            raise InputError(path, field, problem, mend)
        kept.append(batch)
    return ArrowTable(path, mend, pa.Table.from_batches(kept, schema))


def check_batches(path: Path, mend: str, limit: int) -> None:
    """Check an Arrow file of any size that a library reads batch by batch, without checks.

    Args:
        limit: bytes that a batch may take in memory.

    Raises:
        InputError: it is damaged, or a batch is larger.
    """
    field = "Arrow file"
    with _arrow_errors(path, field, mend), pa.memory_map(os.fsencode(path)) as source:
        reader = ipc.open_file(source, options=ipc.IpcReadOptions(use_threads=False))
        for batch in _batches(reader):
            if batch.nbytes > limit:
                problem = f"has a batch of {batch.nbytes} bytes, {limit} are read at most"
                raise InputError(path, field, problem, mend)


def write_parquet(path: Path, table: pa.Table) -> None:
    """Write a table, whole or not at all; the same table gives the same bytes.

    Raises:
        InputError: the disk refuses.
    """
    with atomic_file(path) as partial, partial.open("wb") as stream:
        pq.write_table(table, stream)


class ParquetRows:
    """Some columns of a parquet file, read piece by piece.

    Attributes:
        schema: Arrow schema of these columns.
        first_rows: (groups + 1,) the number of each row group's first row, and of all rows.
    """

    def __init__(self, path: Path, columns: Sequence[str], mend: str) -> None:
        """Open a file and read what it says of itself.

        Args:
            mend: what the user can do about any fault.

        Raises:
            InputError: the file is missing or damaged, or a column is missing or of no plain type.
        """
        self._path, self._columns, self._mend = Path(path), [*columns], mend
        if not self._path.is_file():
            raise InputError(path, "file", "is missing", mend)
        with _arrow_errors(self._path, "parquet file", mend):
            # Column chunks are read bit by bit: whole, those of a row group may be 100 MB.
            stream = pa.OSFile(os.fsencode(self._path))  # a text would be taken as UTF-8
            self._file = pq.ParquetFile(stream, buffer_size=1 << 20)
            schema, metadata = self._file.schema_arrow, self._file.metadata
            _require_plain(self._path, schema, columns, mend)
            self.schema = pa.schema([schema.field(name) for name in columns])
            groups = [metadata.row_group(group) for group in range(metadata.num_row_groups)]
            counts = [group.num_rows for group in groups]
            if min(counts, default=0) < 0 or sum(counts) >= 1 << 62:
                raise ValueError("a row group without a number of rows")
        self.first_rows = np.cumsum([0, *counts], dtype=np.int64)

    def batches(self, group: int, rows_at_once: int = _ROWS_AT_ONCE) -> Iterator[pa.RecordBatch]:
        """The rows of a row group in order, at most `rows_at_once` at a time, validated in full.

        Raises:
            InputError: the file is damaged, or a piece takes more than `STREAM_LIMIT` bytes.
        """
        field = f"row group {group}"
        left = int(self.first_rows[group + 1] - self.first_rows[group])
        with _arrow_errors(self._path, field, self._mend):
            found = self._file.iter_batches(
                rows_at_once, row_groups=[group], columns=self._columns, use_threads=False
            )
        while left:
            with _arrow_errors(self._path, field, self._mend):
                batch = next(found).select(self._columns)
                batch.validate(full=True)
                left -= batch.num_rows
                if batch.nbytes > STREAM_LIMIT or left < 0:
                    problem = f"holds more than {STREAM_LIMIT} bytes, or more rows than it says"
                    raise InputError(self._path, field, problem, self._mend)
            yield batch


NPY_LIMIT = 1 << 31
"""Bytes of an array, at most."""


def read_npy(path: Path, mend: str, limit: int = NPY_LIMIT) -> NDArray[Any]:
    """The array of a .npy file.

    Args:
        mend: what the user can do about any fault.
        limit: bytes that the file may have.

    Raises:
        InputError: the file is missing, too large or damaged, or holds objects.
    """
    path = Path(path)
    if not path.is_file():
        raise InputError(path, "file", "is missing", mend)
    return _array(path, "array", read_bytes(path, limit), mend)


def npz_names(path: Path, mend: str) -> list[str]:
    """Names of the arrays in a .npz archive.

    Raises:
        InputError: the file is missing or no archive.
    """
    with _archive(path, mend) as archive:
        return [name.removesuffix(".npy") for name in archive.namelist() if name.endswith(".npy")]


def read_npz(
    path: Path, mend: str, names: Sequence[str] | None = None, limit: int = NPY_LIMIT
) -> dict[str, NDArray[Any]]:
    """Arrays of a .npz archive by name.

    Args:
        mend: what the user can do about any fault.
        names: names of the arrays to read; all arrays if None.
        limit: bytes that these arrays may have together, once decompressed.

    Raises:
        InputError: the file is missing or damaged, lacks an array, holds objects, or its arrays are
            too large.
    """
    path = Path(path)
    names = npz_names(path, mend) if names is None else names
    arrays: dict[str, NDArray[Any]] = {}
    with _archive(path, mend) as archive:
        for name in names:
            field = f"array {name}"
            left = limit - sum(array.nbytes for array in arrays.values())
            try:
                entry = archive.getinfo(f"{name}.npy")
            except KeyError:
                raise InputError(path, field, "is missing", mend) from None
            if entry.file_size > left:
                problem = f"has {entry.file_size} bytes, {left} are read at most"
                raise InputError(path, field, problem, mend)
            try:
                data = archive.read(entry)  # gives no more bytes than the entry says
            except Exception as error:  # of the archive, its decompressor, or the disk
                problem = f"cannot be read ({error})"
                raise InputError(path, field, problem, mend) from None
            arrays[name] = _array(path, field, data, mend)
    return arrays


@contextmanager
def _archive(path: Path, mend: str) -> Iterator[zipfile.ZipFile]:
    if not path.is_file():
        raise InputError(path, "file", "is missing", mend)
    with disk_errors(path):
        try:
            archive = zipfile.ZipFile(path)
        except (zipfile.BadZipFile, ValueError, NotImplementedError, EOFError) as error:
            raise InputError(path, "archive", f"cannot be read ({error})", mend) from None
    with archive:
        yield archive


def _array(path: Path, field: str, data: bytes, mend: str) -> NDArray[Any]:
    stream = io.BytesIO(data)
    try:
        # What np.load does to a file of one array; anything else is not tried as a pickle.
        array: NDArray[Any] = np.lib.format.read_array(stream, allow_pickle=False)
    except Exception as error:  # the header is Python text: its parser raises all sorts of things
        reason = " ".join(str(error).split()) or type(error).__name__
        problem = f"cannot be read ({reason})"
        if "allow_pickle" in reason:
            problem = "holds pickled Python objects, which are never loaded"
        raise InputError(path, field, problem, mend) from None
    if array.dtype.kind not in "biufcSUmM":
        raise InputError(path, field, f"holds {str(array.dtype)[:40]}, not plain values", mend)
    if stream.tell() != len(data):
        problem = f"has {len(data) - stream.tell()} bytes after its values"
        raise InputError(path, field, problem, mend)
    return array
