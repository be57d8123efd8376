"""Where the sun may stand, told by which surfaces of a street are bright and which are not.

With the sun in some direction, surfaces that face it unhindered are brighter and warmer than the
others. How well that explains the street says how likely the sun is there. A street hardly proves
one direction: light is worked out with all of them, each by its probability. The sky's own picture
does not help: cameras on cars see a band above the horizon, and the sun stands above that.

Light meets patches of the street's surface, and a grid of what stands in its way.
"""

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
from recast.splats.gaussians import C0, harmonic_basis

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
AZIMUTHS, ELEVATIONS = 24, np.radians([20.0, 30.0, 40.0, 50.0, 60.0, 70.0])
DIRECTIONS = AZIMUTHS * len(ELEVATIONS)
SUN_OVER_SKY = 2.0
"""Light of the sun on what faces it over that of the sky on level ground, on a clear day."""
_BRIGHTNESS, _WARMTH = 1.0, 0.2  # weights of the cues
_GROUND, _WALLS = 50.0, 35.0
"""Independent measurements that ground and walls count for, however many patches they have."""
_PLENTY = 500  # patches; fewer count for less
_MOST, _FEWEST = 1000, 40  # patches of a kind
_UPRIGHT = 0.35  # a normal with less of "up" is that of a wall
_FLATTEST = 0.05  # deviation of the expected light below which a direction explains nothing
_GREY = 0.5  # logarithm of red over blue, from the median
_LIFT_M = 0.3
_VAGUE = 0.1  # certainty below which no direction is named
_BANDS = torch.tensor([torch.pi, *[2 * torch.pi / 3] * 3, *[torch.pi / 4] * 5], dtype=torch.float64)
"""Factors of the clamped cosine in harmonics; Ramamoorthi and Hanrahan (2001), "An efficient
representation for irradiance environment maps"."""


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


@dataclass(frozen=True)
class SunBelief:
    """What a street says of the sun.

    Attributes:
        probability: (D,) probability of each of the `directions`; adds up to one.
    """

    probability: Array

    @property
    def certainty(self) -> float:
        """0 to 1: length of the mean level direction, each direction as a unit vector."""
        level = directions()[0][:, :2]
        level = level / np.linalg.norm(level, axis=1, keepdims=True)
        return float(np.linalg.norm(self.probability @ level))

    @property
    def harmonics(self) -> Array:
        """(9,) coefficients of the expected cosine to the sun, 0 where it is behind, by normal."""
        values = harmonic_basis(torch.from_numpy(directions()[0]), 2).numpy()
        return _BANDS.numpy() * (self.probability @ values)

    def given(self, evidence: Array) -> SunBelief:
        """The belief with more evidence.

        Args:
            evidence: (D,) logarithms of likelihoods, up to a constant.
        """
        probability = self.probability * np.exp(evidence - evidence.max())
        return SunBelief(probability / probability.sum())

    def explain(self) -> str:
        """One line for people."""
        if self.certainty < _VAGUE:
            return "the sun's direction is unknown: light depends on the place, not on the heading"
        x, y, _ = self.probability @ directions()[0]
        return (
            f"sun towards azimuth {np.degrees(np.arctan2(y, x)):.0f} degrees (0 is world x), "
            f"certainty {self.certainty:.2f}"
        )


def directions() -> tuple[Array, Array]:
    """Directions (D, 3) for the sun, all azimuths for each elevation, and their shares (D,)."""
    azimuth = np.arange(AZIMUTHS) * 2 * np.pi / AZIMUTHS
    e, a = (grid.ravel() for grid in np.meshgrid(ELEVATIONS, azimuth, indexing="ij"))
    return se3.direction(a, e), np.cos(e) / np.cos(e).sum()


def find_sun(patches: Patches, occupancy: Occupancy) -> SunBelief:
    """How likely the sun stands in each direction."""
    towards, prior = directions()
    patches = patches.select(patches.lifeless)
    upright = np.abs(patches.normals[:, 2]) < _UPRIGHT
    evidence = np.zeros(len(towards))
    for chosen, trust in ((patches.level, _GROUND), (upright, _WALLS)):
        rows = np.flatnonzero(chosen)
        group = patches.select(rows[:: max(-(-len(rows) // _MOST), 1)])
        if len(group) < _FEWEST:
            continue
        trust *= min(len(group) / _PLENTY, 1.0)
        bright, warmth = np.log(group.brightness), group.warmth
        grey = np.abs(warmth - np.median(warmth)) < _GREY
        for index, direction in enumerate(towards):
            light = _expected(group, occupancy, direction)
            explained = _BRIGHTNESS * _explained(light, bright)
            explained += _WARMTH * _explained(light[grey], warmth[grey])
            evidence[index] += trust * explained
    return SunBelief(prior).given(evidence)


def _expected(patches: Patches, occupancy: Occupancy, towards: Array) -> Array:
    """Logarithm (P,) of the light with the sun there over that without one."""
    facing = np.maximum(patches.normals @ towards, 0)
    lit = np.flatnonzero(facing > 0)
    seen = np.zeros(len(patches))
    seen[lit] = occupancy.through(patches.points[lit] + _LIFT_M * patches.normals[lit], towards)
    sky = 0.5 + 0.5 * patches.normals[:, 2]
    return np.log1p(SUN_OVER_SKY * facing * seen / np.maximum(sky, 0.1))


def _explained(light: Array, values: Array) -> float:
    """Gain in log-likelihood for each measurement: -log(1 - r^2) / 2, for r > 0."""
    if len(light) < _FEWEST or light.std() < _FLATTEST or values.std() == 0:
        return 0.0
    r = max(float(np.corrcoef(light, values)[0, 1]), 0.0)
    return -0.5 * float(np.log(max(1 - r * r, 1e-6)))
