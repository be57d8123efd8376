"""A folder of training assets."""

from __future__ import annotations

from functools import lru_cache
from pathlib import Path

import torch
from torch import Tensor

from recast.errors import InputError
from recast.recar.assets.asset import FEATURES, TrainingAsset, read_asset
from recast.trellis.sparse import SparseTensor

_KEPT = 64  # assets decoded at a time, 1.6 MB each


class AssetStore:
    """Assets by number, read when asked for.

    Args:
        folder: with `asset-*.npz`.

    Raises:
        InputError: no assets there.
    """

    def __init__(self, folder: Path) -> None:
        self.folder = folder
        self.paths = sorted(folder.glob("asset-*.npz"))
        if not self.paths:
            raise InputError(folder, "assets", "none found", "make some: recast recar assets")
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
            "assets", "coords", f"reach {largest}, the networks take {resolution} a side",
            "make the assets again",
        )  # fmt: skip
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
