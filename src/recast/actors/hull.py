"""The outer surface of a Gaussian asset: what a LiDAR could have hit."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
import torch
from numpy.typing import NDArray
from scipy.ndimage import median_filter
from scipy.spatial import cKDTree

from recast.geometry import se3
from recast.splats import Gaussians

Array = NDArray[np.float64]

_MIN_OPACITY = 0.3
_LEAST_SPREAD = 1e-3  # of the thinnest direction over the longest: less is a sheet, not a vehicle
_PER_CELL = 8  # Gaussians per cell of the depth maps that decide what is outside
_FLAT = 0.5  # a Gaussian whose least deviation is below this share of its middle one has a normal


@dataclass(frozen=True)
class Surface:
    """Surface-like centres of an asset.

    Attributes:
        points: (N, 3).
        normals: (N, 3) unit, of either sign.
        index: (N,) int64 into the Gaussians.
    """

    points: Array
    normals: Array
    index: NDArray[np.int64]


def outer_surface(gaussians: Gaussians) -> Surface:
    """Opaque Gaussians that are frontmost from at least one of 26 directions around the asset.

    Works in the asset's own units. Normals are the shortest axes of flat Gaussians; for round ones
    the plane through the twelve nearest neighbours.

    Raises:
        ValueError: see `require_volume`, of the opaque Gaussians.
    """
    with torch.no_grad():
        opaque = np.flatnonzero(torch.sigmoid(gaussians.logit_opacities).numpy() > _MIN_OPACITY)
    points = gaussians.means.detach().numpy().astype(np.float64)[opaque]
    require_volume(points)
    outside = seen_from_outside(points)[1].any(axis=0)
    kept = opaque[outside]
    points = points[outside]
    return Surface(points, _normals(gaussians, kept, points), kept)


def require_volume(points: Array) -> None:
    """Refuse what cannot be a vehicle's opaque points (N, 3).

    Raises:
        ValueError: fewer than 50, or all in one place, on a line or in a plane.
    """
    if len(points) < 50:
        raise ValueError(f"{len(points)} opaque points, at least 50 are needed")
    spread = np.linalg.svd(points - points.mean(axis=0), compute_uv=False)
    if not spread[-1] > _LEAST_SPREAD * spread[0]:
        raise ValueError("opaque points lie in one place, on a line or in a plane")


def seen_from_outside(points: Array) -> tuple[Array, NDArray[np.bool_]]:
    """26 directions of view (26, 3), and which points (N, 3) are frontmost along each, (26, N)."""
    # empty cells would let inner points through
    cells = np.clip(np.sqrt(len(points) / _PER_CELL), 8, 128)
    cell = float(np.ptp(points, axis=0).max()) / float(cells)
    directions = _directions()
    return directions, np.stack([_frontmost(points, one, cell) for one in directions])


def _directions() -> Array:
    steps = np.stack(np.meshgrid(*[[-1, 0, 1]] * 3, indexing="ij"), -1).reshape(-1, 3)
    steps = steps[np.any(steps != 0, axis=1)].astype(np.float64)
    unit: Array = steps / np.linalg.norm(steps, axis=1, keepdims=True)
    return unit


def _frontmost(points: Array, direction: Array, cell: float) -> NDArray[np.bool_]:
    """Points (N, 3) not more than 1.5 cells behind a depth map seen along `direction`.

    A median over 3x3 cells closes the map where a cell happens to hold no outer point.
    """
    helper = np.array([0.0, 0.0, 1.0]) if abs(direction[2]) < 0.9 else np.array([1.0, 0.0, 0.0])
    across = np.cross(helper, direction)
    across /= np.linalg.norm(across)
    basis = np.stack([across, np.cross(direction, across)], axis=-1)
    cells = np.floor(points @ basis / cell).astype(np.int64)
    row, column = (cells - cells.min(axis=0)).T
    depth = points @ direction
    beyond = float(depth.max()) + 10 * cell
    nearest = np.full((row.max() + 1, column.max() + 1), beyond)
    np.minimum.at(nearest, (row, column), depth)
    closed = median_filter(nearest, size=3, mode="constant", cval=beyond)
    front: NDArray[np.bool_] = depth < closed[row, column] + 1.5 * cell
    return front


def _normals(gaussians: Gaussians, index: NDArray[np.int64], points: Array) -> Array:
    deviations = np.exp(gaussians.log_scales.detach().numpy().astype(np.float64)[index])
    rotations = se3.quat_to_matrix(gaussians.quats.detach().numpy()[index])
    order = np.argsort(deviations, axis=1)
    shortest = np.take_along_axis(rotations, order[:, None, :1], axis=2)[:, :, 0]
    ranked = np.take_along_axis(deviations, order, axis=1)
    flat = ranked[:, 0] < _FLAT * ranked[:, 1]
    if flat.all():
        return shortest
    neighbours = points[cKDTree(points).query(points[~flat], k=12)[1]]
    centred = neighbours - neighbours.mean(axis=1, keepdims=True)
    _, vectors = np.linalg.eigh(np.swapaxes(centred, 1, 2) @ centred)
    normals = shortest.copy()
    normals[~flat] = vectors[:, :, 0]
    return normals


def bounds(points: Array, share: float = 0.002) -> tuple[Array, Array]:
    """Lower and upper corner (3,) of points (N, 3) without the outermost `share` on each side."""
    low, high = np.quantile(points, [share, 1 - share], axis=0)
    return low, high
