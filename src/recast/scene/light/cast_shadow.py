"""The shadow of a vehicle on the road: of the sky around its wheels, of the sun on one side."""

from __future__ import annotations

import numpy as np
import torch
from numpy.typing import NDArray
from scipy.ndimage import gaussian_filter
from scipy.spatial import cKDTree

from recast.scene.light.place import PlaceLight, SceneLight, near_stations
from recast.scene.light.sun import AZIMUTHS, directions
from recast.scene.light.surfaces import GAMMA
from recast.splats import Gaussians
from recast.splats.sh import C0

Array = NDArray[np.float64]

_SPACING_M = 0.16
_WIDTH = 0.85  # of a Gaussian, in spacings
_OVERLAP = 2 * np.pi * _WIDTH**2  # sum of the weights of neighbours
_LOWEST_SUN = np.radians(25.0)  # the shadow of a lower one is drawn no longer
_POINTS = 1500
_BLUR = 1.2  # cells: closes the gaps between points, and a penumbra
_HIT = 0.25  # blurred share of a cell's neighbourhood that points must hit to count as full
_TOE = 1.5  # cameras darken shade: a shadow looks as if the sun that it lacks were stronger
_THICKNESS_M = 0.003
_FAINTEST, _DARKEST = 0.015, 0.97


class CastShadow:
    """A sheet of flat black Gaussians that takes from the road the light that the vehicle hides.

    The sun is not known for sure: what it lacks is the mean over all directions, each by its
    probability. An uncertain sun casts a faint, wide shadow.

    Args:
        points: (N, 3) on the outer surface of the vehicle, actor frame.
        contact: level sheet of Gaussians, as opaque as the share of the sky that the vehicle hides.
        size: (3,) of its box, metres.
    """

    def __init__(self, points: Array, contact: Gaussians, size: Array) -> None:
        points = points[:: max(1, len(points) // _POINTS)]
        towards, _ = directions()
        sheet = contact.means.detach().cpu().numpy().astype(np.float64)
        ground = float(np.median(sheet[:, 2]))
        height = np.maximum(points[:, 2] - ground, 0)
        reach = height.max() / np.tan(_LOWEST_SUN)
        low = np.minimum(points[:, :2].min(axis=0) - reach, sheet[:, :2].min(axis=0))
        high = np.maximum(points[:, :2].max(axis=0) + reach, sheet[:, :2].max(axis=0))
        x, y = (np.arange(a, b + _SPACING_M, _SPACING_M) for a, b in zip(low, high, strict=True))
        shape = (len(x), len(y))
        self._sun = np.zeros((len(towards), len(x) * len(y)), np.float32)
        for index, direction in enumerate(towards):
            level = float(np.linalg.norm(direction[:2]))
            away = direction[:2] / max(direction[2], level * np.tan(_LOWEST_SUN))
            cell = np.rint((points[:, :2] - height[:, None] * away - low) / _SPACING_M)
            hit = np.zeros(shape, np.float32)
            hit[tuple(cell.astype(np.int64).T)] = 1.0
            self._sun[index] = np.minimum(gaussian_filter(hit, _BLUR) / _HIT, 1.0).ravel()
        self._low, self._shape = low, np.array(shape)
        grid = np.stack(np.meshgrid(x, y, indexing="ij"), axis=-1).reshape(-1, 2)
        self._centres = np.concatenate([grid, np.full((len(grid), 1), ground)], axis=1)
        self._stations = near_stations(grid[:, 0], size)
        self._left = _light_left(sheet, contact, grid)

    @property
    def room(self) -> int:
        """Most Gaussians that a sheet has."""
        return len(self._centres)

    def left(self, place: PlaceLight, yaw: float, at: Array) -> tuple[Array, Array]:
        """Share (D, P) of the light that reaches places if the sun stands in each direction.

        Args:
            yaw: heading of the vehicle in the world, radians; directions are those of the world.
            at: (P, 2) places on the ground, actor frame, metres.

        Returns:
            The share with the vehicle there, and that if it did not hide the sky.
        """
        found = np.rint((at - self._low) / _SPACING_M).astype(np.int64)
        x, y = np.clip(found, 0, self._shape - 1).T
        cells = x * self._shape[1] + y
        hidden = _turned(self._sun[:, cells].astype(np.float64), -yaw)
        sky = self._stations[cells] @ place.sky
        sun = _TOE * directions()[0][:, 2:] * (self._stations[cells] @ place.sun)
        return _left(sky, self._left[cells], sun, hidden), _left(sky, 1.0, sun, hidden)

    def sheet(self, light: SceneLight, place: PlaceLight, yaw: float) -> Gaussians:
        """The shadow, actor frame.

        Args:
            yaw: heading of the vehicle in the world, radians.
        """
        hidden = _turned(light.sun.probability, yaw).astype(np.float32) @ self._sun
        sky = self._stations @ place.sky
        sun = _TOE * light.sun_on_ground * (self._stations @ place.sun)
        left = _left(sky, self._left, sun, hidden)
        dark = 1 - left ** (1 / GAMMA)
        kept = np.flatnonzero(dark > _FAINTEST)
        opacity = 1 - (1 - np.minimum(dark[kept], _DARKEST)) ** (1 / _OVERLAP)
        wide, count = np.log(_WIDTH * _SPACING_M), len(kept)
        scales = torch.tensor([wide, wide, np.log(_THICKNESS_M)], dtype=torch.float32)
        return Gaussians(
            means=torch.from_numpy(self._centres[kept]).float(),
            quats=torch.tensor([[1.0, 0.0, 0.0, 0.0]]).repeat(count, 1),
            log_scales=scales.repeat(count, 1),
            logit_opacities=torch.from_numpy(np.log(opacity / (1 - opacity))).float(),
            sh=torch.full((count, 1, 3), -0.5 / C0),
        )


def _left(
    sky: Array, sky_left: Array | float, sun: Array, sun_hidden: NDArray[np.floating]
) -> Array:
    """Share of the light of sky and sun that is left where both are hidden in part."""
    left: Array = (sky * sky_left + sun * (1 - sun_hidden)) / (sky + sun)
    return left


def _light_left(sheet: Array, contact: Gaussians, grid: Array) -> Array:
    """(G,) share of the sky's light that a sheet of Gaussians leaves to places (G, 2)."""
    opacity = torch.sigmoid(contact.logit_opacities.detach()).numpy().astype(np.float64)
    width = np.exp(contact.log_scales.detach().numpy()[:, :2].astype(np.float64)).mean(axis=1)
    depth = np.zeros(len(grid))
    tree = cKDTree(grid)
    for centre, reach, alpha, near in zip(
        sheet[:, :2], width, opacity, tree.query_ball_point(sheet[:, :2], 3 * width), strict=True
    ):
        distance = ((grid[near] - centre) ** 2).sum(axis=1)
        depth[near] -= np.log1p(-alpha * np.exp(-distance / (2 * reach**2)))
    left: Array = np.exp(-depth)
    return left


def _turned(values: Array, yaw: float) -> Array:
    """Values (D, ...) by direction, for the directions of a frame that is turned by `yaw`."""
    table = values.reshape(-1, AZIMUTHS, *values.shape[1:])
    steps = yaw * AZIMUTHS / (2 * np.pi)
    whole = int(np.floor(steps))
    share = steps - whole
    turned: Array = (1 - share) * np.roll(table, -whole, axis=1) + share * np.roll(
        table, -whole - 1, axis=1
    )
    return turned.reshape(values.shape)
