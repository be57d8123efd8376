"""From coloured surface points to voxels with features."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

Array = NDArray[np.float64]


def voxelise(
    points: Array, colours: Array, normals: Array, resolution: int, least: int = 2
) -> tuple[NDArray[np.uint8], NDArray[np.float16]]:
    """Bin points of a surface into a grid over the unit cube.

    Args:
        points: (N, 3) in [-0.5, 0.5]; those outside are left out.
        colours: (N, 3) display values in [0, 1].
        normals: (N, 3) unit.
        resolution: R voxels a side.
        least: points that make a voxel occupied; lonely ones are often rounding.

    Returns:
        Coordinates (T, 3), lexicographic, and features (T, 17), see `asset.FEATURES`.
    """
    scaled = (points + 0.5) * resolution
    inside = np.all((scaled >= 0) & (scaled < resolution), axis=1)
    scaled, colours, normals = scaled[inside], colours[inside], normals[inside]
    cell = np.floor(scaled).astype(np.int64)
    key = (cell[:, 0] * resolution + cell[:, 1]) * resolution + cell[:, 2]
    unique, which, count = np.unique(key, return_inverse=True, return_counts=True)
    offset = scaled - cell - 0.5
    octant = ((offset > 0) * [4, 2, 1]).sum(axis=1)
    total = np.zeros((len(unique), 17))
    np.add.at(total[:, :9], which, np.hstack([2 * colours - 1, normals, offset]))
    total[which, 9 + octant] = 1
    total[:, :9] /= count[:, None]
    kept = count >= least
    unique, total = unique[kept], total[kept]
    coords = np.stack(
        [unique // resolution**2, unique // resolution % resolution, unique % resolution], axis=1
    )
    return coords.astype(np.uint8), total.astype(np.float16)
