"""A pseudo-target: the latents that the adaptation trains towards, for one vehicle."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray


@dataclass(frozen=True)
class Target:
    """What the multi-image pipeline made of one vehicle (S, P and Z of the paper, section 2).

    Attributes:
        structure: (C, r, r, r) float32 sparse-structure latent as sampled; axes x, y, z.
        coords: (T, 3) int32 active voxels x, y, z in [0, R), in lexicographic order.
        latent: (T, C) float32 structured latent on them, raw: not normalised.

    Raises:
        ValueError: other shapes, no voxel, voxels in another order or twice, or values that are
            not finite.
    """

    structure: NDArray[np.float32]
    coords: NDArray[np.int32]
    latent: NDArray[np.float32]

    def __post_init__(self) -> None:
        shape = self.structure.shape
        if len(shape) != 4 or len(set(shape[1:])) != 1:
            raise ValueError(f"structure latent of shape {shape}, expected (C, r, r, r)")
        count = len(self.coords)
        if self.coords.shape != (count, 3) or self.latent.ndim != 2 or len(self.latent) != count:
            raise ValueError(
                f"coords {self.coords.shape} and latent {self.latent.shape}, not (T, 3), (T, C)"
            )
        if count == 0:
            raise ValueError("no active voxel")
        if self.coords.min() < 0 or not _rising(self.coords):
            raise ValueError("coords are below zero, not in order, or there twice")
        if not (np.isfinite(self.structure).all() and np.isfinite(self.latent).all()):
            raise ValueError("values that are not finite")


def _rising(coords: NDArray[np.int32]) -> bool:
    """Whether rows (T, 3) ascend strictly, the first column first."""
    x, y, z = np.diff(coords.astype(np.int64), axis=0).T
    return bool(np.all((x > 0) | ((x == 0) & ((y > 0) | ((y == 0) & (z > 0))))))
