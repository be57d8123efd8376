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
        ValueError: other shapes, no voxel, or values that are not finite.
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
        if not (np.isfinite(self.structure).all() and np.isfinite(self.latent).all()):
            raise ValueError("values that are not finite")

    def flipped(self, resolution: int) -> Target:
        """The target turned by 180 degrees about z, for a vehicle that came out rear to front.

        Indices along x and y run backwards: exact for the voxels. What the channels of the latents
        say of directions inside a voxel is not turned with them, so that decoded surfaces are only
        about right; the networks' autoencoders know no symmetry that could be used instead.

        Args:
            resolution: R voxels a side.
        """
        coords = self.coords * np.array([-1, -1, 1], np.int32)
        coords += np.array([resolution - 1, resolution - 1, 0], np.int32)
        order = np.lexsort(coords.T[::-1])
        structure = np.ascontiguousarray(self.structure[:, ::-1, ::-1])
        return Target(structure, coords[order], self.latent[order])
