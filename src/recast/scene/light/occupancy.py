"""What stands in the way of light in a street: a grid of voxels, each more or less filled."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

Array = NDArray[np.float64]

VOXEL_M = 0.5
MOST_VOXELS = 8_000_000
_DENSITY = 1.5  # optical depth of a voxel that is filled by one Gaussian
_NEAR, _FAR = 16, 64  # voxels: every one up to here, every second beyond, none farther
_STEPS = np.array([*range(1, _NEAR), *range(_NEAR, _FAR, 2)], np.float32)
_STRIDES = np.where(_STEPS < _NEAR, 1, 2).astype(np.float32)


class Occupancy:
    """Filled voxels.

    Args:
        points: (N, 3) centres of Gaussians, metres.
        filled: (N,) share of a voxel that each fills.
        around: (M, 3) places that stay inside where the grid would be too large.

    Raises:
        ValueError: neither points nor places.
    """

    def __init__(self, points: Array, filled: Array, around: Array) -> None:
        everything = np.concatenate([points, around])
        if len(everything) == 0:
            raise ValueError("Occupancy: no points")
        low, high = everything.min(axis=0) - VOXEL_M, everything.max(axis=0) + VOXEL_M
        middle = around.mean(axis=0) if len(around) else (low + high) / 2
        while np.prod(np.ceil((high - low) / VOXEL_M)) > MOST_VOXELS:
            low, high = 0.9 * low + 0.1 * middle, 0.9 * high + 0.1 * middle
        # A rim of empty voxels: whoever leaves the grid is taken to be there.
        self._low = low - VOXEL_M
        self._shape = np.ceil((high - low) / VOXEL_M).astype(np.int32) + 2
        inside = np.all((points >= low) & (points < high), axis=1)
        index = self._index(((points[inside] - self._low) / VOXEL_M).T)
        depth = np.bincount(index, _DENSITY * filled[inside], int(self._shape.prod()))
        self._depth = depth.astype(np.float32)

    def _index(self, places: NDArray[np.floating]) -> NDArray[np.int32]:
        """Flat index (...) of places (3, ...) in voxels."""
        x, y, z = (
            np.clip(place, 0, size - 1).astype(np.int32)
            for place, size in zip(places, self._shape, strict=True)
        )
        index: NDArray[np.int32] = (x * self._shape[1] + y) * self._shape[2] + z
        return index

    def through(self, points: Array, towards: Array) -> Array:
        """Share (N,) of light from a unit direction (3,) that reaches points (N, 3)."""
        start = np.ascontiguousarray(((points - self._low) / VOXEL_M).T, np.float32)
        step = towards.astype(np.float32)[:, None, None]
        index = self._index(start[:, None] + _STEPS[:, None] * step)
        depth = _STRIDES @ self._depth[index]
        passed: Array = np.exp(-depth.astype(np.float64))
        return passed
