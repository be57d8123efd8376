"""Arrays of NumPy from foreign files, .npy and .npz; pickled objects are never loaded."""

from __future__ import annotations

import io
import zipfile
from collections.abc import Iterator, Sequence
from contextlib import contextmanager
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from recast.core.errors import InputError
from recast.core.files import disk_errors, read_bytes

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
