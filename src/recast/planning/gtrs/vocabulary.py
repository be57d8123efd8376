"""Trajectory vocabularies from files."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import torch
from numpy.typing import NDArray
from torch import Tensor

from recast.errors import InputError
from recast.planning.types import WAYPOINTS
from recast.storage import atomic_file

Trajectories = NDArray[np.float32]

_MEND = f"give a .npy file of shape (L, {WAYPOINTS}, 3): x, y, heading every 0.1 s"


def read_vocabulary(path: str | Path) -> Trajectories:
    """Read trajectories (L, 40, 3) from a `.npy` file, as float32.

    Each is x, y, heading of the rear axle in the present ego frame, metres and radians, at 0.1 s ..
    4 s. No pickle is read.

    Raises:
        InputError: the file is missing, is no array of numbers, or `check_vocabulary` refuses it.
    """
    path = Path(path)
    if not path.is_file():
        raise InputError(path, "vocabulary", "is missing or no file", "check the path")
    try:
        # Mapped first: what the header claims is checked before memory is asked for.
        array = np.load(path, mmap_mode="r", allow_pickle=False)
    except Exception as error:  # NumPy reads headers as Python literals, and raises as that does
        raise InputError(path, "vocabulary", f"cannot be read ({error})", _MEND) from None
    if not isinstance(array, np.ndarray):
        raise InputError(path, "vocabulary", "holds several arrays", _MEND)
    return check_vocabulary(path, array)


def check_vocabulary(where: str | Path, array: NDArray[np.generic] | Tensor) -> Trajectories:
    """A copy of `array` as a vocabulary, float32.

    Args:
        where: the file, for the message.

    Raises:
        InputError: it is not (L, 40, 3) with L at least 1, holds no floating-point numbers, or NaN
            or infinite ones.
    """
    shape = tuple(array.shape)
    if len(shape) != 3 or shape[1:] != (WAYPOINTS, 3) or shape[0] == 0:
        raise InputError(where, "vocabulary", f"has shape {shape}", _MEND)
    if isinstance(array, Tensor):
        if not array.is_floating_point():
            raise InputError(where, "vocabulary", f"holds {array.dtype}, not numbers", _MEND)
        array = array.detach().to(torch.float64).numpy()
    if not np.issubdtype(array.dtype, np.floating):
        raise InputError(where, "vocabulary", f"holds {array.dtype}, not numbers", _MEND)
    with np.errstate(over="ignore"):  # becomes infinite, which is refused
        trajectories = np.array(array, np.float32)
    bad = np.flatnonzero(~np.isfinite(trajectories).all(axis=(1, 2)))
    if len(bad):
        raise InputError(
            where, "vocabulary",
            f"trajectory {bad[0]} holds NaN or infinity ({len(bad)} of {len(trajectories)} do)",
            _MEND,
        )  # fmt: skip
    return trajectories


def write_vocabulary(path: str | Path, trajectories: Trajectories) -> None:
    """Write trajectories (L, 40, 3) as `.npy`, float32, whole or not at all."""
    with atomic_file(path) as partial, partial.open("wb") as file:
        np.save(file, check_vocabulary(path, trajectories), allow_pickle=False)
