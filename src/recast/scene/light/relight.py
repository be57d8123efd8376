"""A vehicle's recorded light exchanged for that of where it stands, and its shadow on the road."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace

import numpy as np
import torch
from numpy.typing import NDArray
from scipy.ndimage import gaussian_filter
from scipy.spatial import cKDTree
from torch import Tensor

from recast.arrays import Array
from recast.geometry.colour import GAMMA
from recast.scene.actor import SceneActor, rounded
from recast.scene.light.place import LitSurface, PlaceLight, SceneLight, near_stations
from recast.scene.light.sun import AZIMUTHS, directions
from recast.splats import Gaussians
from recast.splats.sh import C0

# Of the sheet that is the shadow.
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

COAT = 0.04
"""Reflectance of clear coat and glass at normal incidence."""
_MOST_MIRRORED = 0.5  # of a colour; the rest is paint, even on black
_DARKENING, _BRIGHTENING = 0.9, 0.3
"""Powers of the ratio of light, new over old. What gets brighter is trusted less: cameras flatten
what is bright, and generators know usual light: their shaded colours are not as dark as shade."""
_RATIO = (0.1, 6.0)
_LEAST_LIT = 0.02  # display value


class ActorLight:
    """What is needed to light a vehicle anew: a `recast.scene.actor.Lighting`.

    Args:
        scene: light of the street.
        gaussians: the vehicle, actor frame, in the light that it was recorded in.
        surface: normals and places of the Gaussians.
        recorded: (N,) float32 light that each Gaussian's colour was recorded in.
        shadow: what makes the shadow; None if the vehicle has none.
    """

    def __init__(
        self,
        scene: SceneLight,
        gaussians: Gaussians,
        surface: LitSurface,
        recorded: Tensor,
        shadow: CastShadow | None,
    ) -> None:
        self.scene, self.surface, self.recorded, self.shadow = scene, surface, recorded, shadow
        self._paint = Paint(gaussians, COAT * scene.sky_radiance)

    @property
    def shadow_room(self) -> int:
        """Most Gaussians that the shadow has."""
        return 0 if self.shadow is None else self.shadow.room

    def lit(self, actor: SceneActor, pose: Array) -> SceneActor:
        """The actor in the light of where it stands, and not to be lit again.

        Args:
            pose: (4, 4) `world_from_actor`.
        """
        pose = rounded(pose)
        place = self.scene.place(pose, actor.size)
        light = self.scene.on(place, self.surface, pose[:3, :3])
        gaussians = self._paint.under(light / self.recorded)
        shadow = actor.shadow
        if self.shadow is not None:
            yaw = float(np.arctan2(pose[1, 0], pose[0, 0]))
            shadow = self.shadow.sheet(self.scene, place, yaw)
        return replace(actor, gaussians=gaussians, shadow=shadow, light=None)


def recorded_light(
    scene: SceneLight,
    surface: LitSurface,
    size: Array,
    poses: Sequence[Array],
    weights: Sequence[float] | None = None,
) -> Tensor:
    """Mean light (N,) that fell on a vehicle's surface over the places where it was seen.

    Args:
        size: (3,) size of the vehicle's box, metres.
        poses: (4, 4) `world_from_actor` each, at least one.
        weights: weights of the poses; the same for all if not given.
    """
    shares = np.ones(len(poses)) if weights is None else np.asarray(weights, np.float64)
    total = torch.zeros(len(surface.normals))
    for pose, share in zip(map(rounded, poses), shares / shares.sum(), strict=True):
        total += float(share) * scene.on(scene.place(pose, size), surface, pose[:3, :3])
    return total


class Paint:
    """A vehicle's colours, taken apart: what coat and glass mirror of the sky, the rest is paint.

    Args:
        gaussians: Gaussians in the light that they were recorded in.
        mirrored: linear radiance up to which a colour may be mirrored.
    """

    def __init__(self, gaussians: Gaussians, mirrored: float) -> None:
        self._gaussians = gaussians
        linear = ((0.5 + C0 * gaussians.sh[:, 0]).clamp(_LEAST_LIT, 1) ** GAMMA).mean(dim=1)
        self._coat = (mirrored / linear).clamp(max=_MOST_MIRRORED)

    def under(self, ratio: Tensor) -> Gaussians:
        """The Gaussians whose paint gets `ratio` (N,) times the light; what they mirror stays.

        Colours keep their hue. A ratio of exactly one changes nothing.
        """
        ratio = ratio.clamp(*_RATIO)
        gain = torch.where(ratio < 1, ratio**_DARKENING, ratio**_BRIGHTENING)
        factor = torch.lerp(gain, torch.ones_like(gain), self._coat) ** (1 / GAMMA)
        sh = self._gaussians.sh * factor[:, None, None]
        sh[:, 0] += (0.5 / C0) * (factor - 1)[:, None]
        return replace(self._gaussians, sh=sh)


class CastShadow:
    """A sheet of flat black Gaussians that takes from the road the light that the vehicle hides.

    The sun is not known for sure: what it lacks is the mean over all directions, each by its
    probability. An uncertain sun casts a faint, wide shadow.

    Args:
        points: (N, 3) points on the outer surface of the vehicle, actor frame.
        contact: level sheet of Gaussians, as opaque as the share of the sky that the vehicle hides.
        size: (3,) size of the vehicle's box, metres.
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
    return (sky * sky_left + sun * (1 - sun_hidden)) / (sky + sun)


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
    return np.exp(-depth)


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
