"""What light meets in a street: patches of its surface, and a grid of what stands in the way."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
import torch
from numpy.typing import NDArray
from scipy.spatial import cKDTree

from recast.arrays import Array, Mask
from recast.geometry import se3
from recast.geometry.colour import gamma_to_linear
from recast.splats import Gaussians
from recast.splats.sh import C0

VOXEL_M = 0.5
MOST_VOXELS = 8_000_000
_DENSITY = 1.5  # optical depth of a voxel that is filled by one Gaussian
_NEAR, _FAR = 16, 64  # voxels: every one up to here, every second beyond, none farther
_STEPS = np.array([*range(1, _NEAR), *range(_NEAR, _FAR, 2)], np.float32)
_STRIDES = np.where(_STEPS < _NEAR, 1, 2).astype(np.float32)

PATCH_M = 1.0
"""Edge of the cells whose Gaussians make one patch."""
_REACH_M = 45.0  # from the vehicles' paths: farther off, a street is a blur
_LOWEST_M, _HIGHEST_M = -5.0, 30.0  # against the paths' mean height
_OPAQUE, _FLAT, _WIDEST_M = 0.3, 0.5, 1.5
_LEVEL = 0.9  # a normal with more of "up" is that of the ground or of a roof
_GREEN = 0.2  # logarithm of green over red and blue from which on a patch is leaves or grass
_BLACK = 0.004  # linear light


@dataclass(frozen=True)
class Patches:
    """Pieces of surface a metre wide: means over the flat, opaque Gaussians of a cell.

    Attributes:
        points: (P, 3) world frame.
        normals: (P, 3) unit, outward.
        colours: (P, 3) linear light.
    """

    points: Array
    normals: Array
    colours: Array

    def __len__(self) -> int:
        return len(self.points)

    @property
    def level(self) -> Mask:
        """(P,) those that face upwards: ground and roofs."""
        return self.normals[:, 2] > _LEVEL

    @property
    def brightness(self) -> Array:
        """(P,) linear light, mean of the channels."""
        return np.maximum(self.colours.mean(axis=1), _BLACK)

    @property
    def warmth(self) -> Array:
        """(P,) logarithm of red over blue."""
        red, _, blue = np.log(np.maximum(self.colours, _BLACK)).T
        return red - blue

    @property
    def lifeless(self) -> Mask:
        """(P,) those that are not green: roads, pavements, walls."""
        red, green, blue = np.log(np.maximum(self.colours, _BLACK)).T
        return green - (red + blue) / 2 < _GREEN

    def select(self, index: NDArray[np.int64] | Mask) -> Patches:
        """Some of them."""
        return Patches(self.points[index], self.normals[index], self.colours[index])


def street_surfaces(background: Gaussians, paths: Array) -> tuple[Patches, Occupancy]:
    """What can be seen of a street, and what stands in the way of its light.

    Args:
        paths: (M, 3) places where vehicles stood, M at least 1; only what lies near is looked at.
    """
    means = background.means.detach().cpu().numpy().astype(np.float64)
    above = means[:, 2] - paths[:, 2].mean()
    distance = cKDTree(paths[:, :2]).query(means[:, :2], distance_upper_bound=_REACH_M)[0]
    near = np.isfinite(distance) & (above > _LOWEST_M) & (above < _HIGHEST_M)
    means, part = means[near], background.detach().to("cpu").select(torch.from_numpy(near))
    deviations = np.exp(part.log_scales.double().numpy())
    opacity = 1 / (1 + np.exp(-part.logit_opacities.double().numpy()))
    filled = opacity * np.minimum(2 * deviations.max(axis=1) / VOXEL_M, 1.0) ** 2
    occupancy = Occupancy(means, filled, paths)

    order = np.argsort(deviations, axis=1)
    thin, middle, wide = np.take_along_axis(deviations, order, axis=1).T
    flat = (opacity > _OPAQUE) & (thin < _FLAT * middle) & (wide < _WIDEST_M)
    axes = se3.quat_to_matrix(part.quats.double().numpy()[flat])
    normals = np.take_along_axis(axes, order[flat, None, :1], axis=2)[:, :, 0]
    normals = _outward(means[flat], normals, paths)
    colours = gamma_to_linear(0.5 + C0 * part.sh[:, 0].double().numpy()[flat])
    areas = (opacity * middle * wide)[flat]
    return _gathered(means[flat], normals, colours, areas), occupancy


def _outward(points: Array, normals: Array, paths: Array) -> Array:
    """Normals turned upwards where they are level, towards the road elsewhere.

    Cameras stood on the road: what was seen of a wall faces it.
    """
    nearest = paths[cKDTree(paths).query(points)[1]]
    towards = np.sum(normals * (nearest - points), axis=1)
    sign = np.where(np.abs(normals[:, 2]) > _LEVEL, normals[:, 2], towards)
    return np.where(sign < 0, -1.0, 1.0)[:, None] * normals


def _gathered(points: Array, normals: Array, colours: Array, areas: Array) -> Patches:
    """Means over cells of place and of the side that is faced."""
    axis = np.abs(normals).argmax(axis=1)
    side = 2 * axis + (np.take_along_axis(normals, axis[:, None], axis=1)[:, 0] > 0)
    keys = np.concatenate([np.floor(points / PATCH_M).astype(np.int64), side[:, None]], axis=1)
    cells, cell = np.unique(keys, axis=0, return_inverse=True)
    cell = cell.reshape(-1)
    total = np.bincount(cell, areas, len(cells))[:, None]

    def mean(values: Array) -> Array:
        sums = [np.bincount(cell, areas * column, len(cells)) for column in values.T]
        return np.stack(sums, axis=-1) / total

    facing = mean(normals)
    length = np.linalg.norm(facing, axis=1, keepdims=True)
    return Patches(mean(points), facing / np.maximum(length, 1e-9), mean(colours))


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
        return (x * self._shape[1] + y) * self._shape[2] + z

    def through(self, points: Array, towards: Array) -> Array:
        """Share (N,) of light from a unit direction (3,) that reaches points (N, 3)."""
        start = np.ascontiguousarray(((points - self._low) / VOXEL_M).T, np.float32)
        step = towards.astype(np.float32)[:, None, None]
        index = self._index(start[:, None] + _STEPS[:, None] * step)
        depth = _STRIDES @ self._depth[index]
        return np.exp(-depth.astype(np.float64))
