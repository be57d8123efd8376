"""Compressed NumPy archives, written whole or not at all; `recast.tables.read_npz` reads them."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from recast.storage import atomic_file


def write_arrays(path: Path, **arrays: NDArray[Any]) -> None:
    """Write named arrays; the same arrays give the same bytes.

    Raises:
        InputError: the disk is full.
    """
    with atomic_file(path) as partial, partial.open("wb") as stream:
        np.savez_compressed(stream, allow_pickle=False, **arrays)
