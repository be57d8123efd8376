"""A 3D asset to learn from: voxels with what is seen on them, and pictures from all around.

Frame: the unit cube of the image-to-3D model, [-0.5, 0.5]^3, longest side 1, z up; vehicles look
along +x.
"""

from __future__ import annotations

from dataclasses import dataclass, fields
from functools import lru_cache
from pathlib import Path
from typing import Any

import numpy as np
import torch
from numpy.typing import NDArray
from torch import Tensor

from recast.core.array_files import read_npz
from recast.core.errors import InputError
from recast.recar.views import write_arrays
from recast.trellis.sparse import SparseTensor

FEATURES = 17
"""Colour, normal, centroid in the voxel (three each) and eight sub-voxels' occupancy."""
_KEPT = 64  # assets decoded at a time, 1.6 MB each


@dataclass(frozen=True)
class TrainingAsset:
    """One asset.

    Attributes:
        kind: kind of the vehicle or shape.
        size: (3,) extents in the unit cube before the asset was centred, longest 1.
        coords: (T, 3) uint8 voxels of the visible surface, lexicographic.
        features: (T, 17) float16, see `FEATURES`; colours and normals in [-1, 1], the centroid in
            voxels from its centre, sub-voxels 0 or 1.
        pictures: (V, S, S, 4) uint8 RGBA with straight alpha.
        poses: (V, 4, 4) float32 `camera_from_asset`.
        focal: (V,) float32 focal lengths in pixels; the principal point is the middle.
        crops: number of pictures, the first ones, that look as a car's camera would see them.
    """

    kind: str
    size: NDArray[np.float32]
    coords: NDArray[np.uint8]
    features: NDArray[np.float16]
    pictures: NDArray[np.uint8]
    poses: NDArray[np.float32]
    focal: NDArray[np.float32]
    crops: int

    def validate(self) -> None:
        """Check types, shapes and ranges.

        Raises:
            ValueError: the first that is wrong.
        """
        voxels, views = self.coords.shape[:1], self.pictures.shape[:1]
        pixels = self.pictures.shape[1:2]
        for name, dtype, shape in (
            ("size", np.float32, (3,)),
            ("coords", np.uint8, (*voxels, 3)),
            ("features", np.float16, (*voxels, FEATURES)),
            ("pictures", np.uint8, (*views, *pixels, *pixels, 4)),
            ("poses", np.float32, (*views, 4, 4)),
            ("focal", np.float32, views),
        ):
            found = getattr(self, name)
            if found.dtype != dtype or found.shape != shape:
                raise ValueError(f"{name}: is {found.dtype} {found.shape}, not {dtype} {shape}")
            if not np.isfinite(found).all():
                raise ValueError(f"{name}: holds values that are not finite")
        if not voxels or not pixels or 0 in (*voxels, *views, *pixels):
            raise ValueError("holds no voxels or no images")
        if not 0 < self.crops <= len(self.pictures) or not (self.focal > 0).all():
            raise ValueError(
                f"crops is {self.crops}, of {len(self.pictures)} images, or a focal length is <= 0"
            )


_MEND = "make the assets again"
_MOST_BYTES = 1 << 29
_ARRAYS = tuple(field.name for field in fields(TrainingAsset))


def write_asset(path: Path, asset: TrainingAsset) -> None:
    """Write an asset as a compressed NumPy archive, whole or not at all."""
    write_arrays(
        path,
        kind=np.array(asset.kind),
        size=asset.size,
        coords=asset.coords,
        features=asset.features,
        pictures=asset.pictures,
        poses=asset.poses,
        focal=asset.focal,
        crops=np.array(asset.crops),
    )


def read_asset(path: Path) -> TrainingAsset:
    """Read what `write_asset` wrote.

    Raises:
        InputError: missing, cut short, or of another layout.
    """
    found = read_npz(path, _MEND, _ARRAYS, _MOST_BYTES)
    try:
        values: dict[str, Any] = {**found, "kind": str(found["kind"]), "crops": int(found["crops"])}
        asset = TrainingAsset(**values)
        asset.validate()
    except (TypeError, ValueError) as error:
        raise InputError(path, "arrays", str(error), _MEND) from None
    return asset


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
