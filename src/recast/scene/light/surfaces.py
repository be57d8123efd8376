"""Patches of a street's surface: which way they face, and how bright they are."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from scipy.spatial import cKDTree

from recast.geometry import se3
from recast.scene.light.occupancy import VOXEL_M, Occupancy
from recast.splats import Gaussians
from recast.splats.sh import C0

Array = NDArray[np.float64]
Mask = NDArray[np.bool_]

GAMMA = 2.2
"""Power law between display values and linear light."""
PATCH_M = 1.0
"""Edge of the cells whose Gaussians make one patch."""
_REACH_M = 45.0  # from the vehicles' paths: farther off, a street is a blur
_LOWEST_M, _HIGHEST_M = -5.0, 30.0  # against the paths' mean height
_OPAQUE, _FLAT, _WIDEST_M = 0.3, 0.5, 1.5
_LEVEL = 0.9  # a normal with more of "up" is that of the ground or of a roof
_GREEN = 0.2  # logarithm of green over red and blue from which on a patch is leaves or grass
_BLACK = 0.004  # linear light


def to_linear(display: Array) -> Array:
    """Linear light of display values, by the power law."""
    return np.power(np.clip(display, 0.0, 1.0), GAMMA)


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
        warmth: Array = red - blue
        return warmth

    @property
    def lifeless(self) -> Mask:
        """(P,) those that are not green: roads, pavements, walls."""
        red, green, blue = np.log(np.maximum(self.colours, _BLACK)).T
        found: Mask = green - (red + blue) / 2 < _GREEN
        return found

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
    part = _Arrays.of(background, np.flatnonzero(near))
    filled = part.opacity * np.minimum(2 * part.deviations.max(axis=1) / VOXEL_M, 1.0) ** 2
    occupancy = Occupancy(part.means, filled, paths)

    order = np.argsort(part.deviations, axis=1)
    thin, middle, wide = np.take_along_axis(part.deviations, order, axis=1).T
    flat = (part.opacity > _OPAQUE) & (thin < _FLAT * middle) & (wide < _WIDEST_M)
    axes = se3.quat_to_matrix(part.quats[flat])
    normals = np.take_along_axis(axes, order[flat, None, :1], axis=2)[:, :, 0]
    normals = _outward(part.means[flat], normals, paths)
    areas = (part.opacity * middle * wide)[flat]
    return _gathered(part.means[flat], normals, part.colours[flat], areas), occupancy


@dataclass(frozen=True)
class _Arrays:
    """Gaussians as float64 arrays."""

    means: Array
    quats: Array
    deviations: Array
    opacity: Array
    colours: Array

    @classmethod
    def of(cls, gaussians: Gaussians, rows: NDArray[np.int64]) -> _Arrays:
        def array(values: object) -> Array:
            return np.asarray(values, np.float64)[rows]

        g = gaussians.detach().to("cpu")
        return cls(
            means=array(g.means),
            quats=array(g.quats),
            deviations=np.exp(array(g.log_scales)),
            opacity=1 / (1 + np.exp(-array(g.logit_opacities))),
            colours=to_linear(0.5 + C0 * array(g.sh[:, 0])),
        )


def _outward(points: Array, normals: Array, paths: Array) -> Array:
    """Normals turned upwards where they are level, towards the road elsewhere.

    Cameras stood on the road: what was seen of a wall faces it.
    """
    nearest = paths[cKDTree(paths).query(points)[1]]
    towards = np.sum(normals * (nearest - points), axis=1)
    sign = np.where(np.abs(normals[:, 2]) > _LEVEL, normals[:, 2], towards)
    turned: Array = np.where(sign < 0, -1.0, 1.0)[:, None] * normals
    return turned


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
