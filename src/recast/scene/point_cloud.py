"""Point clouds with colours, and Gaussians made of them."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
import torch
from numpy.typing import NDArray
from scipy.spatial import cKDTree

from recast.geometry import se3
from recast.splats import Gaussians, morton_order
from recast.splats.sh import C0

Array = NDArray[np.float64]
Float32Array = NDArray[np.float32]

FLATNESS = 0.3
"""A neighbourhood counts as flat where it is this much thinner than narrow."""


@dataclass(frozen=True)
class PointCloud:
    """Coloured points.

    Attributes:
        points: (N, 3) float32 metres.
        colours: (N, 3) float32 in [0, 1].
        distances: (N,) float32 metres to the camera that gave the colour.
    """

    points: Float32Array
    colours: Float32Array
    distances: Float32Array

    def __len__(self) -> int:
        return len(self.points)

    @classmethod
    def empty(cls) -> PointCloud:
        """No points."""
        return cls(*(np.zeros(shape, np.float32) for shape in ((0, 3), (0, 3), (0,))))

    def select(self, index: NDArray[np.generic]) -> PointCloud:
        """The points at an index or mask."""
        return PointCloud(self.points[index], self.colours[index], self.distances[index])


def concatenate(clouds: list[PointCloud]) -> PointCloud:
    """One cloud of several; none gives an empty one."""
    if not clouds:
        return PointCloud.empty()
    return PointCloud(
        np.concatenate([cloud.points for cloud in clouds]),
        np.concatenate([cloud.colours for cloud in clouds]),
        np.concatenate([cloud.distances for cloud in clouds]),
    )


def voxel_downsample(cloud: PointCloud, voxel_m: float) -> PointCloud:
    """One point a voxel: the one that a camera saw from nearest, for the sharpest colour."""
    if len(cloud) == 0:
        return cloud
    cells = np.floor(cloud.points / voxel_m).astype(np.int64)
    cells -= cells.min(axis=0)
    spans = cells.max(axis=0) + 1
    keys = (cells[:, 0] * spans[1] + cells[:, 1]) * spans[2] + cells[:, 2]
    order = np.lexsort((cloud.distances, keys))
    first = np.ones(len(order), bool)
    first[1:] = np.diff(keys[order]) != 0
    return cloud.select(order[first])


def thinned(cloud: PointCloud, share: float, rng: np.random.Generator) -> PointCloud:
    """A share of the points, at least one and in their order; all of them from a share of 1 on."""
    if share >= 1 or len(cloud) == 0:
        return cloud
    count = max(1, int(share * len(cloud)))
    return cloud.select(np.sort(rng.choice(len(cloud), count, replace=False)))


def neighbour_distance(points: Float32Array, neighbours: int = 3) -> Float32Array:
    """Root mean square distance (N,) to the nearest `neighbours` other points, metres."""
    if len(points) <= neighbours:
        return np.full(len(points), 0.1, np.float32)
    distance, _ = cKDTree(points).query(points, k=neighbours + 1)
    rms: Float32Array = np.sqrt((distance[:, 1:] ** 2).mean(axis=1)).astype(np.float32)
    return rms


def surface_frames(points: Float32Array, neighbours: int = 10) -> tuple[Array, Array]:
    """Principal axes of every point's neighbourhood.

    Returns:
        rotations (N, 3, 3), columns the axes from the thinnest on, right-handed, and the spread
        (N, 3) along them in metres. Identity and equal spreads where there are too few points.
    """
    n = len(points)
    if n <= neighbours:
        return np.broadcast_to(np.eye(3), (n, 3, 3)).copy(), np.ones((n, 3))
    _, index = cKDTree(points).query(points, k=neighbours + 1)
    offsets = points[index] - points[index].mean(axis=1, keepdims=True)
    values, axes = np.linalg.eigh(np.einsum("nki,nkj->nij", offsets, offsets).astype(np.float64))
    axes[np.linalg.det(axes) < 0, :, 2] *= -1
    return axes, np.sqrt(np.maximum(values, 0) / (neighbours + 1))


def gaussians_from_points(
    cloud: PointCloud,
    sh_degree: int,
    *,
    opacity: float = 0.3,
    scale: float = 0.7,
    sigma_range: tuple[float, float] = (0.01, 3.0),
) -> Gaussians:
    """Gaussians in Morton order, sigma = scale x rms distance to three neighbours.

    Where the neighbourhood is flat, they are discs in its plane, `FLATNESS` as thick as wide, so
    that a road seen from another lane is still one surface; elsewhere they are balls.

    Args:
        sigma_range: least and largest standard deviation along the surface, metres.
    """
    cloud = cloud.select(morton_order(torch.from_numpy(cloud.points)).numpy())
    n = len(cloud)
    sigma = np.clip(scale * neighbour_distance(cloud.points), *sigma_range)
    axes, spread = surface_frames(cloud.points)
    flat = spread[:, 0] < FLATNESS * spread[:, 1]
    axes[~flat] = np.eye(3)
    scales = np.repeat(sigma[:, None], 3, axis=1)
    scales[flat, 0] = np.maximum(FLATNESS * sigma[flat], sigma_range[0])
    sh = torch.zeros(n, (sh_degree + 1) ** 2, 3)
    sh[:, 0] = (torch.from_numpy(cloud.colours) - 0.5) / C0
    return Gaussians(
        means=torch.from_numpy(cloud.points.astype(np.float32)),
        quats=torch.from_numpy(se3.matrix_to_quat(axes).astype(np.float32)),
        log_scales=torch.from_numpy(np.log(scales).astype(np.float32)),
        logit_opacities=torch.full((n,), float(np.log(opacity / (1 - opacity)))),
        sh=sh,
    )
