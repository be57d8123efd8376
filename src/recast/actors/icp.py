"""Constrained ICP of an asset's outer surface to LiDAR: isotropic scale, yaw and translation.

The LiDAR is partial, so every LiDAR point looks for its nearest surface point and never the other
way round. Distances are taken along surface normals (point to plane, Chen and Medioni 1992), the
worst 15 % are left out, the rest weighted by Huber's function, and weak priors hold what the
points do not tell: a car seen only from the rear has no length. The outer surface is what a LiDAR
could have hit.
"""

from __future__ import annotations

from dataclasses import dataclass
from itertools import product
from typing import TypeVar

import numpy as np
import torch
from numpy.typing import NDArray
from scipy.ndimage import binary_dilation, label, median_filter
from scipy.spatial import cKDTree

from recast.arrays import Array
from recast.geometry import se3
from recast.splats import Gaussians

Kind = TypeVar("Kind", bound=np.generic)

_MIN_OPACITY = 0.3
_LEAST_SPREAD = 1e-3  # of the thinnest direction over the longest: less is a sheet, not a vehicle
_PER_CELL = 8  # Gaussians per cell of the depth maps that decide what is outside
_FLAT = 0.5  # a Gaussian whose least deviation is below this share of its middle one has a normal
INLIER_DISTANCE = 0.10  # metres


@dataclass(frozen=True)
class FitSurface:
    """Surface-like centres of an asset."""

    points: Array  # (N, 3)
    normals: Array  # (N, 3) unit, of either sign
    index: NDArray[np.int64]  # (N,) int64 into the Gaussians


def outer_surface(gaussians: Gaussians) -> FitSurface:
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
    return FitSurface(points, _normals(gaussians, kept, points), kept)


# Parts of an asset: cells along its length at most (14 cm of a car), Gaussians for each square of
# that many, and the share of its opaque Gaussians from which on a part that touches no other
# belongs to it, as a trailer does.
_CELLS, _PER_SQUARE, _PART = 32, 16, 0.03


def belonging(gaussians: Gaussians) -> NDArray[np.bool_]:
    """Which Gaussians (N,) belong to an asset and do not float around it.

    Image-to-3D models leave clusters in the air. Opaque Gaussians in neighbouring cells are one
    part; small parts and whatever lies beside the others are floaters.
    """
    means = gaussians.means.detach().numpy().astype(np.float64)
    solid = torch.sigmoid(gaussians.logit_opacities.detach()).numpy() > _MIN_OPACITY
    if not solid.any():
        return np.ones(len(means), bool)
    count = int(np.clip(np.sqrt(solid.sum() / _PER_SQUARE), 4, _CELLS))
    low, high = np.quantile(means[solid], [0.05, 0.95], axis=0)  # not the floaters' own extent
    edge = max(float((high - low).max()), 1e-9) / count
    # Far floaters share the outermost cells.
    cells = np.clip(np.floor((means - low) / edge), -2 * count, 3 * count).astype(np.int64)
    cells -= cells.min(axis=0)
    index = tuple(cells.T)
    filled = np.zeros(cells.max(axis=0) + 1, np.int64)
    np.add.at(filled, tuple(cells[solid].T), 1)
    everywhere = np.ones((3, 3, 3), bool)
    part, parts = label(filled > 0, structure=everywhere)
    size = np.bincount(part.ravel(), filled.ravel(), parts + 1)
    size[0] = 0
    kept = (size >= _PART * solid.sum()) | (size == size.max())
    kept[0] = False
    return np.asarray(binary_dilation(kept[part], everywhere)[index])


def require_volume(points: Array) -> None:
    """Refuse what cannot be a vehicle's opaque points (N, 3). Raises ValueError: fewer than 50, or
    all in one place, on a line or in a plane."""
    if len(points) < 50:
        raise ValueError(f"{len(points)} opaque points, at least 50 are needed")
    spread = np.linalg.svd(points - points.mean(axis=0), compute_uv=False)
    if not spread[-1] > _LEAST_SPREAD * spread[0]:
        raise ValueError("all opaque points lie at one point, on a line or in a plane")


def seen_from_outside(points: Array) -> tuple[Array, NDArray[np.bool_]]:
    """26 directions of view (26, 3), and which points (N, 3) are frontmost along each, (26, N)."""
    # empty cells would let inner points through
    cells = np.clip(np.sqrt(len(points) / _PER_CELL), 8, 128)
    cell = float(np.ptp(points, axis=0).max()) / float(cells)
    steps = np.array([step for step in product((-1.0, 0.0, 1.0), repeat=3) if any(step)])
    directions = steps / np.linalg.norm(steps, axis=1, keepdims=True)
    return directions, np.stack([_frontmost(points, one, cell) for one in directions])


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
    return depth < closed[row, column] + 1.5 * cell


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


def extent(points: Array, share: float = 0.002) -> Array:
    """Sides of the box between the corners that `bounds` gives."""
    low, high = bounds(points, share)
    return high - low


def thinned(points: NDArray[Kind], count: int) -> NDArray[Kind]:
    """At most about `count` of the rows, evenly through the list (sweeps come in order)."""
    return points[:: max(1, -(-len(points) // count))]


@dataclass(frozen=True)
class IcpLimits:
    """Bounds and stopping rule."""

    scale: tuple[float, float] = (0.8, 1.25)  # smallest and largest factor
    # prior deviation of the factor's logarithm from 0, which is the start: the length of the box,
    # as labels give it.
    scale_deviation: float = 0.025
    yaw: float = float(np.radians(15.0))  # largest turn either way, radians
    shift: float = 0.5  # longest translation, metres
    trim: float = 0.15  # share of the worst points left out
    iterations: int = 60  # largest number of iterations
    # stop when the largest move of a surface point falls below this, metres.
    tolerance: float = 2e-4


@dataclass(frozen=True)
class Fit:
    """How well LiDAR points lie on a surface: distances to the nearest surface point."""

    # median, mean: metres, over all points.
    median: float
    mean: float
    inlier_share: float  # points nearer than 0.10 m


@dataclass(frozen=True)
class IcpResult:
    """asset_aligned = R(yaw) (scale x) + translation."""

    # scale, yaw: factor and radians.
    scale: float
    yaw: float
    translation: Array  # (3,) metres
    iterations: int  # number of iterations done
    converged: bool  # whether ICP stopped by `tolerance` and not by `iterations`

    @property
    def matrix(self) -> Array:
        """(4, 4) rigid part, applied after the scale."""
        return se3.from_rotation_translation(se3.rotation_z(self.yaw), self.translation)

    def apply(self, points: Array) -> Array:
        """Points (N, 3) moved."""
        return se3.apply(self.matrix, points * self.scale)


def fit_of(surface_points: Array, lidar: Array) -> Fit:
    """Nearest-neighbour distances from LiDAR points (M, 3) to surface points (N, 3)."""
    distance, _ = cKDTree(surface_points).query(lidar)
    return Fit(
        median=float(np.median(distance)),
        mean=float(np.mean(distance)),
        inlier_share=float(np.mean(distance < INLIER_DISTANCE)),
    )


# Prior deviations of yaw (radians) and translation (metres); how many independent measurements a
# cloud is worth; and to how many metres each is good, before what the asset is off by is added. A
# generated vehicle is off by centimetres to a decimetre over whole panels: were LiDAR of two sides
# trusted to its own noise, a car that came out too flat would be stretched by a sixth to mend it.
_PRIOR = np.array([0.20, 0.50, 0.50, 0.50])
_EFFECTIVE = 50.0
_NOISE = 0.03


def align(
    surface: FitSurface, lidar: Array, limits: IcpLimits | None = None, floor: float | None = None
) -> IcpResult:
    """The move, within the limits, of a surface onto LiDAR points (M, 3), both in the actor frame.

    Args:
        surface: roughly aligned already, metres.
        limits: bounds and stopping rule.
        floor: height to which the lowest point of the surface is tied; None leaves it free.
    """
    limits = limits or IcpLimits()
    bottom = float(surface.points[:, 2].min())
    # the nearest surface point of a LiDAR point is sought in the frame of the asset as it came
    tree = cKDTree(surface.points)
    state = np.zeros(5)  # log scale, yaw, x, y, z
    if floor is not None:
        state[4] = floor - bottom
    radius = float(np.linalg.norm(surface.points[:, :2], axis=1).max())
    converged, iteration = False, 0
    while not converged and iteration < limits.iterations:
        # matches that flip back and forth settle under shorter steps
        damping = 1.0 if iteration <= 20 else 0.5
        iteration += 1
        step = _step(surface, tree, lidar, state, limits, floor, bottom)
        proposed = _limited(state + damping * step, limits, floor, bottom)
        change, state = proposed - state, proposed
        moved = np.abs(change[:2]).sum() * radius + np.linalg.norm(change[2:])
        converged = bool(moved < limits.tolerance)
    scale, yaw = float(np.exp(state[0])), float(state[1])
    return IcpResult(scale, yaw, state[2:].copy(), iteration, converged)


def _step(
    surface: FitSurface,
    tree: cKDTree,
    lidar: Array,
    state: Array,
    limits: IcpLimits,
    floor: float | None,
    bottom: float,
) -> Array:
    """One Gauss-Newton step (5,) with fresh nearest neighbours."""
    scale, rotation = np.exp(state[0]), se3.rotation_z(state[1])
    local = (lidar - state[2:]) @ rotation / scale
    distance, nearest = tree.query(local)
    kept = distance <= np.quantile(distance, 1 - limits.trim)
    points = surface.points[nearest[kept]] * scale @ rotation.T
    normals = surface.normals[nearest[kept]] @ rotation.T
    residual = np.sum(normals * (lidar[kept] - points - state[2:]), axis=1)

    spread = max(1.4826 * float(np.median(np.abs(residual))), 0.01)
    weight = 1.0 / np.maximum(1.0, np.abs(residual) / (1.5 * spread))
    turned = normals[:, 1] * points[:, 0] - normals[:, 0] * points[:, 1]
    jacobian = np.column_stack([np.sum(normals * points, axis=1), turned, normals])
    prior = state.copy()
    if floor is not None:
        # the height follows from the scale: dz = -bottom * scale * dlog(scale)
        jacobian[:, 0] -= normals[:, 2] * bottom * scale
        jacobian[:, 4] = 0.0
        prior[4] = 0.0
    worth = min(_EFFECTIVE, len(lidar)) / (len(residual) * (_NOISE + spread) ** 2)
    information = 1 / np.array([limits.scale_deviation, *_PRIOR]) ** 2
    normal = worth * (jacobian * weight[:, None]).T @ jacobian + np.diag(information)
    right = worth * jacobian.T @ (weight * residual) - information * prior
    return np.linalg.solve(normal, right)


def _limited(state: Array, limits: IcpLimits, floor: float | None, bottom: float) -> Array:
    """The state inside the limits; the height follows the floor where there is one."""
    state = state.copy()
    state[0] = np.clip(state[0], np.log(limits.scale[0]), np.log(limits.scale[1]))
    state[1] = np.clip(state[1], -limits.yaw, limits.yaw)
    held = 2 if floor is not None else 3
    length = float(np.linalg.norm(state[2 : 2 + held]))
    if length > limits.shift:
        state[2 : 2 + held] *= limits.shift / length
    if floor is not None:
        state[4] = floor - bottom * np.exp(state[0])
    return state
