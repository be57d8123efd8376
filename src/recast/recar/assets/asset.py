"""A 3D asset to learn from: voxels with what is seen on them, and pictures from all around.

Frame: the unit cube of the image-to-3D model, [-0.5, 0.5]^3, longest side 1, z up; vehicles look
along +x.
"""

from __future__ import annotations

from dataclasses import dataclass, fields
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from recast.recar.arrays import read_arrays, write_arrays

FEATURES = 17
"""Colour, normal, centroid in the voxel (three each) and eight sub-voxels' occupancy."""


@dataclass(frozen=True)
class TrainingAsset:
    """One asset.

    Attributes:
        kind: of the vehicle or shape.
        size: (3,) extents in the unit cube before the asset was centred, longest 1.
        coords: (T, 3) uint8 voxels of the visible surface, lexicographic.
        features: (T, 17) float16, see `FEATURES`; colours and normals in [-1, 1], the centroid in
            voxels from its centre, sub-voxels 0 or 1.
        pictures: (V, S, S, 4) uint8 RGBA with straight alpha.
        poses: (V, 4, 4) float32 `camera_from_asset`.
        focal: (V,) float32 pixels; the principal point is the middle.
        crops: how many of the pictures, the first ones, look as a car's camera would.
    """

    kind: str
    size: NDArray[np.float32]
    coords: NDArray[np.uint8]
    features: NDArray[np.float16]
    pictures: NDArray[np.uint8]
    poses: NDArray[np.float32]
    focal: NDArray[np.float32]
    crops: int


_ARRAYS = tuple(field.name for field in fields(TrainingAsset))


def write_asset(path: Path, asset: TrainingAsset) -> None:
    """Write an asset as a compressed NumPy archive, whole or not at all."""
    write_arrays(
        path, kind=np.array(asset.kind), size=asset.size, coords=asset.coords,
        features=asset.features, pictures=asset.pictures, poses=asset.poses,
        focal=asset.focal, crops=np.array(asset.crops),
    )  # fmt: skip


def read_asset(path: Path) -> TrainingAsset:
    """Read what `write_asset` wrote.

    Raises:
        InputError: missing, cut short, or of another layout.
    """
    found = read_arrays(path, _ARRAYS, "make the assets again")
    values: dict[str, Any] = {**found, "kind": str(found["kind"]), "crops": int(found["crops"])}
    return TrainingAsset(**values)
