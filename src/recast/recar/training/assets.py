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

from recast.core.errors import InputError
from recast.recar.views import write_arrays
from recast.tables import read_npz

FEATURES = 17
"""Colour, normal, centroid in the voxel (three each) and eight sub-voxels' occupancy."""


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
