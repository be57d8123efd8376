"""Arrays of numpy from foreign files: the header is checked before memory is taken."""

from __future__ import annotations

import io
import math
import zipfile
import zlib
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import IO, Any

import numpy as np
from numpy.typing import NDArray

from recast.core.errors import InputError
from recast.core.files import disk_errors, read_bytes

NPY_LIMIT = 1 << 31
"""Bytes of an array, at most."""

_HEADERS = {
    (1, 0): np.lib.format.read_array_header_1_0,
    (2, 0): np.lib.format.read_array_header_2_0,
}


@dataclass(frozen=True)
class NpyHeader:
    """What a .npy file says of its array.

    Attributes:
        shape: shape of the array.
        dtype: numbers, bool or fixed text; no objects, no fields.
        fortran: whether the first axis lies densest.
        start: offset in bytes at which the values begin.
    """

    shape: tuple[int, ...]
    dtype: np.dtype[Any]
    fortran: bool
    start: int

    @property
    def size(self) -> int:
        """Bytes of the values."""
        return math.prod(self.shape) * self.dtype.itemsize


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


def npy_header(path: Path, mend: str) -> NpyHeader:
    """The header of a .npy file whose values are all there: what `np.load` may then map.

    Raises:
        InputError: see `read_npy`.
    """
    path = Path(path)
    if not path.is_file():
        raise InputError(path, "file", "is missing", mend)
    with disk_errors(path), path.open("rb") as stream:
        return _header(path, "array", stream, path.stat().st_size, mend)


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
    with open_npz(path, mend) as archive:
        names = npz_names(archive) if names is None else names
        total = 0
        arrays = {}
        for name in names:
            arrays[name] = npz_array(path, archive, name, mend, limit - total)
            total += arrays[name].nbytes
    return arrays


def open_npz(path: Path, mend: str) -> zipfile.ZipFile:
    """A .npz archive, for `npz_names` and `npz_array`.

    Raises:
        InputError: the file is missing or no archive.
    """
    if not path.is_file():
        raise InputError(path, "file", "is missing", mend)
    with disk_errors(path):
        try:
            return zipfile.ZipFile(path)
        except (zipfile.BadZipFile, ValueError, NotImplementedError, EOFError) as error:
            raise InputError(path, "archive", f"cannot be read ({error})", mend) from None


def npz_names(archive: zipfile.ZipFile) -> list[str]:
    """Names of the arrays in an archive."""
    return [name.removesuffix(".npy") for name in archive.namelist() if name.endswith(".npy")]


def npz_array(
    path: Path, archive: zipfile.ZipFile, name: str, mend: str, limit: int = NPY_LIMIT
) -> NDArray[Any]:
    """One array of an archive that was opened from `path`.

    Raises:
        InputError: it is missing, damaged, of objects, or takes more than `limit` bytes.
    """
    field = f"array {name}"
    try:
        entry = archive.getinfo(f"{name}.npy")
    except KeyError:
        raise InputError(path, field, "is missing", mend) from None
    if entry.file_size > limit:
        problem = f"has {entry.file_size} bytes, {limit} are read at most"
        raise InputError(path, field, problem, mend)
    try:
        with archive.open(entry) as stream:  # gives no more bytes than the entry says
            data = stream.read()
    except (OSError, ValueError, EOFError, RuntimeError, zipfile.BadZipFile, zlib.error) as error:
        raise InputError(path, field, f"cannot be read ({error})", mend) from None
    return _array(path, field, data, mend)


def _array(path: Path, field: str, data: bytes, mend: str) -> NDArray[Any]:
    header = _header(path, field, io.BytesIO(data), len(data), mend)
    try:
        values = np.frombuffer(data, header.dtype, math.prod(header.shape), header.start)
        return values.reshape(header.shape, order="F" if header.fortran else "C").copy()
    except (ValueError, OverflowError) as error:  # an axis too long, beside one of length 0
        raise InputError(path, field, f"cannot be of its shape ({error})", mend) from None


def _header(path: Path, field: str, stream: IO[bytes], size: int, mend: str) -> NpyHeader:
    try:
        read = _HEADERS[np.lib.format.read_magic(stream)]
        shape, fortran, dtype = read(stream)
    except Exception as error:  # the header is Python text: its parser raises all sorts of things
        reason = " ".join(str(error).split()) or type(error).__name__
        raise InputError(path, field, f"has a damaged header ({reason})", mend) from None
    if dtype.hasobject:
        problem = "holds pickled Python objects, which are never loaded"
        raise InputError(path, field, problem, mend)
    if dtype.kind not in "biufcSUmM" or not dtype.itemsize:
        raise InputError(path, field, f"holds {str(dtype)[:40]}, not plain values", mend)
    header = NpyHeader(tuple(shape), dtype, bool(fortran), stream.tell())
    if any(length < 0 for length in shape):
        raise InputError(path, field, f"has the shape {shape}", mend)
    if header.size != size - header.start:
        problem = f"says {header.size} bytes of values, {size - header.start} are there"
        raise InputError(path, field, problem, mend)
    return header
