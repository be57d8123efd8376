"""Compressed NumPy archives, written whole or not at all, read without pickle."""

from __future__ import annotations

import zlib
from pathlib import Path
from typing import Any
from zipfile import BadZipFile

import numpy as np
from numpy.typing import NDArray

from recast.errors import InputError
from recast.storage import atomic_file


def write_arrays(path: Path, **arrays: NDArray[Any]) -> None:
    """Write named arrays; the same arrays give the same bytes.

    Raises:
        InputError: the disk is full.
    """
    with atomic_file(path) as partial, partial.open("wb") as stream:
        np.savez_compressed(stream, allow_pickle=False, **arrays)


def read_arrays(path: Path, names: tuple[str, ...], mend: str) -> dict[str, NDArray[Any]]:
    """Read named arrays.

    Args:
        mend: what the user can do about any fault.

    Raises:
        InputError: the file is missing, cut short, or lacks an array.
    """
    try:
        with np.load(path, allow_pickle=False) as file:
            return {name: file[name] for name in names}
    except FileNotFoundError:
        raise InputError(path, "file", "is missing", mend) from None
    except (OSError, ValueError, KeyError, EOFError, BadZipFile, zlib.error) as error:
        raise InputError(path, "arrays", f"cannot be read ({error})", mend) from None
