"""Assets as the parts of the small model take them: grids, features, and their spread."""

from __future__ import annotations

from dataclasses import dataclass
from functools import lru_cache
from pathlib import Path

import numpy as np
import torch
from numpy.typing import NDArray
from torch import Tensor

from recast.arrays import Array
from recast.core.errors import InputError
from recast.recar.training_conditions import FEATURES, TrainingAsset, read_asset
from recast.trellis.sparse import SparseTensor

_KEPT = 64  # assets decoded at a time, 1.6 MB each


class AssetStore:
    """Assets by number, read when asked for.

    Args:
        folder: folder with `asset-*.npz`.

    Raises:
        InputError: no assets there.
    """

    def __init__(self, folder: Path) -> None:
        self.folder = folder
        self.paths = sorted(folder.glob("asset-*.npz"))
        if not self.paths:
            raise InputError(folder, "assets", "are missing", "make some: recast recar assets")
        self._read = lru_cache(maxsize=_KEPT)(read_asset)

    def __len__(self) -> int:
        return len(self.paths)

    def __getitem__(self, index: int) -> TrainingAsset:
        return self._read(self.paths[index])


def occupancy(assets: list[TrainingAsset], resolution: int) -> Tensor:
    """(B, 1, R, R, R) float32, 1 in occupied voxels.

    Raises:
        InputError: an asset was made for more voxels a side.
    """
    largest = max(int(asset.coords.max()) for asset in assets)
    if largest >= resolution:
        raise InputError(
            "assets",
            "coords",
            f"reach {largest}, but the networks take {resolution} voxels a side",
            "make the assets again",
        )
    grid = torch.zeros(len(assets), 1, resolution, resolution, resolution)
    for index, asset in enumerate(assets):
        x, y, z = torch.from_numpy(asset.coords).long().unbind(1)
        grid[index, 0, x, y, z] = 1.0
    return grid


def voxel_features(assets: list[TrainingAsset]) -> SparseTensor:
    """Features (T, 17) on the voxels of assets, one sample each."""
    assert all(asset.features.shape[1] == FEATURES for asset in assets)
    return SparseTensor.stack(
        [torch.from_numpy(asset.coords).int() for asset in assets],
        [torch.from_numpy(asset.features).float() for asset in assets],
    )


@dataclass(frozen=True)
class ChannelStatistics:
    """Mean and standard deviation by channel, float64 (C,), over all values of all targets."""

    mean: Array
    std: Array


class ChannelMoments:
    """Adds up values, without losing digits to a large mean (Chan et al. 1979)."""

    def __init__(self) -> None:
        self._count = 0
        self._mean: Array = np.zeros(0)
        self._squares: Array = np.zeros(0)

    def add(self, values: NDArray[np.float32]) -> None:
        """Add values (N, C) with N >= 1."""
        block = values.astype(np.float64)
        count, mean = len(block), block.mean(axis=0)
        squares = np.square(block - mean).sum(axis=0)
        if self._count == 0:
            self._count, self._mean, self._squares = count, mean, squares
            return
        total, delta = self._count + count, mean - self._mean
        self._squares = self._squares + squares + delta**2 * self._count * count / total
        self._mean = self._mean + delta * count / total
        self._count = total

    def statistics(self) -> ChannelStatistics | None:
        """Over all values, dividing by their number; None where there are none."""
        if self._count == 0:
            return None
        return ChannelStatistics(self._mean, np.sqrt(self._squares / self._count))
