"""Arrays of numpy from foreign files: the header is checked before memory is taken."""

from __future__ import annotations

import io
import math
import zipfile
import zlib
from collections.abc import Sequence
from pathlib import Path
from typing import Any

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
    stream = io.BytesIO(data)
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
    if any(length < 0 for length in shape):
        raise InputError(path, field, f"has the shape {shape}", mend)
    start, count = stream.tell(), math.prod(shape)
    if count * dtype.itemsize != len(data) - start:
        told = f"{count * dtype.itemsize} bytes of values, {len(data) - start} are present"
        raise InputError(path, field, f"says {told}", mend)
    try:
        values = np.frombuffer(data, dtype, count, start)
        return values.reshape(shape, order="F" if fortran else "C").copy()
    except (ValueError, OverflowError) as error:  # an axis too long, beside one of length 0
        raise InputError(path, field, f"does not fit its shape ({error})", mend) from None
