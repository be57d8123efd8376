"""The light of a place, told by its street alone, and a vehicle's own light exchanged for it."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from functools import cached_property
from typing import Self

import numpy as np
import torch
from numpy.typing import NDArray
from scipy.ndimage import gaussian_filter
from scipy.spatial import cKDTree
from torch import Tensor

from recast.arrays import Array
from recast.geometry import se3
from recast.geometry.colour import GAMMA, gamma_to_linear
from recast.scene.actor import SceneActor, rounded
from recast.scene.light.sun import (
    AZIMUTHS,
    SUN_OVER_SKY,
    Patches,
    SunBelief,
    directions,
    find_sun,
    street_surfaces,
)
from recast.scene.street_scene import StreetScene
from recast.splats import Gaussians, concatenate
from recast.splats.gaussians import C0, harmonic_basis, rotate_harmonics

_LANE_M = 1.5  # from vehicles' paths: there it is road that is seen
_ROAD_OVER_SKY = 0.35  # least brightness of sunlit road over that of the sky near the horizon
_SHADED = 0.2  # brightness of shaded road under the open sky over that of sunlit road
_PATCHY = (
    0.15  # roads are patchy: deviation of the logarithm within which sun and shade are blurred
)
_STATIONS = (-0.8, 0.0, 0.8)  # along a vehicle, in halves of its length
_AROUND_M = (1.5, 3.0)  # from a station
_FEWEST = 4
_FLOOR_M = 0.5
_BOUNCE = 0.15  # of the light on the ground, what it sends back up
_BESIDE = 0.3  # light from the sides where a roof hides the sky, on what faces sideways
_DARKEST = 0.2
_SKY_BAND = (0.0, np.radians(20.0))  # elevations that cameras on cars see
_POSES = 60  # places of vehicles that say how bright the street is as a rule


@dataclass(frozen=True)
class PlaceLight:
    """Light of a place, in units of that of the open sky on level ground.

    Attributes:
        sky: (S,) light of the sky at stations along a vehicle, 1 in the open, less where the sky is
            hidden.
        sun: (S,) light of the sun on what faces it, 0 in the shade.
        seen: (S,) whether road was seen there; where not, the street's usual light is taken.
    """

    sky: Array
    sun: Array
    seen: NDArray[np.bool_]


@dataclass(frozen=True)
class LitSurface:
    """What light needs to know of a vehicle's surface, worked out once.

    Attributes:
        normals: (N, 3) unit, outward, actor frame.
        harmonics: (N, 9) real harmonics of degree 2 in the direction of the normals.
        stations: (N, S) how near each point is to the stations along the vehicle; rows add up to 1.
    """

    normals: Tensor
    harmonics: Tensor
    stations: Tensor

    @classmethod
    def of(cls, normals: Tensor, points: Tensor, size: Array) -> Self:
        """The surface of points and normals (N, 3), actor frame, of a vehicle of `size` (3,)."""
        shares = near_stations(points[:, 0].detach().cpu().numpy().astype(np.float64), size)
        return cls(normals, harmonic_basis(normals, 2), torch.from_numpy(shares).to(normals))


def near_stations(ahead: Array, size: Array) -> Array:
    """(N, S) weights of the stations at places (N,) in metres ahead of a vehicle's middle."""
    along = np.array(_STATIONS) * size[0] / 2
    return np.stack([np.interp(ahead, along, one) for one in np.eye(len(along))], axis=-1)


@dataclass(frozen=True)
class SceneLight:
    """The light of a street.

    Attributes:
        sun: belief about where the sun may stand.
        sky_radiance: mean linear light of the sky near the horizon: what clear coats mirror.
        sunlit: linear brightness of road in the sun; None where no road was seen.
        road: patches of level ground that is not green.
        usual: light of sky and sun where no road was seen.
    """

    sun: SunBelief
    sky_radiance: float
    sunlit: float | None
    road: Patches
    usual: tuple[float, float] = (1.0, SUN_OVER_SKY)

    @classmethod
    def of(cls, scene: StreetScene) -> Self:
        """What a trained street says of its light.

        Raises:
            ValueError: the scene has no actor, so that nothing tells where its road is.
        """
        if not scene.actors:
            raise ValueError("SceneLight.of: the scene has no actor")
        actors = scene.actors.values()
        paths = np.concatenate([actor.trajectory.poses[:, :3, 3] for actor in actors])
        patches, occupancy = street_surfaces(scene.background, paths)
        road = patches.select(patches.level & patches.lifeless)
        light = cls(find_sun(patches, occupancy), _sky_radiance(scene), None, road)
        if len(road) == 0:
            return light
        lanes = cKDTree(paths[:, :2]).query(road.points[:, :2])[0] < _LANE_M
        if lanes.sum() < _FEWEST:
            return light
        # Most road is in the sun, or it is far darker than the sky.
        usual = float(np.median(road.brightness[lanes]))
        light = replace(light, sunlit=max(usual, _ROAD_OVER_SKY * light.sky_radiance))
        poses = [(pose, actor.size) for actor in actors for pose in actor.trajectory.poses]
        places = [light.place(*each) for each in poses[:: -(-len(poses) // _POSES)]]
        seen = np.concatenate([place.seen for place in places])
        if not seen.any():
            return light
        sky = np.concatenate([place.sky for place in places])[seen]
        sun = np.concatenate([place.sun for place in places])[seen]
        return replace(light, usual=(float(sky.mean()), float(sun.mean())))

    @cached_property
    def _tree(self) -> cKDTree:
        return cKDTree(self.road.points[:, :2])

    @cached_property
    def _harmonics(self) -> Tensor:
        return torch.from_numpy(self.sun.harmonics)

    @cached_property
    def sun_on_ground(self) -> float:
        """Expected cosine between the sun and the vertical."""
        up = torch.tensor([0.0, 0.0, 1.0], dtype=torch.float64)
        return float(harmonic_basis(up, 2) @ self._harmonics)

    def brightness(self, point: Array) -> float | None:
        """Median linear brightness of the road around a point (3,) on it; None if none was seen."""
        for around in _AROUND_M:
            rows = np.array(self._tree.query_ball_point(point[:2], around), np.int64)
            rows = rows[np.abs(self.road.points[rows, 2] - point[2]) < _FLOOR_M]
            if len(rows) >= _FEWEST:
                return float(np.median(self.road.brightness[rows]))
        return None

    def place(self, pose: Array, size: Array) -> PlaceLight:
        """The light where a vehicle stands, at stations along it.

        Args:
            pose: (4, 4) `world_from_actor`.
            size: (3,) size of the vehicle's box, metres.
        """
        along = np.array(_STATIONS) * size[0] / 2
        ground = np.stack([along, 0 * along, 0 * along - size[2] / 2], axis=-1)
        sky, sun = (np.full(len(along), usual) for usual in self.usual)
        seen = np.zeros(len(along), bool)
        for index, point in enumerate(se3.apply(pose, ground)):
            found = None if self.sunlit is None else self.brightness(point)
            if found is None or self.sunlit is None:
                continue
            ratio = found / self.sunlit
            seen[index] = True
            sky[index] = np.clip(ratio / _SHADED, _DARKEST, 1.0)
            sun[index] = SUN_OVER_SKY / (1 + (ratio / np.sqrt(_SHADED)) ** (-1 / _PATCHY))
        return PlaceLight(sky, sun, seen)

    def on(self, place: PlaceLight, surface: LitSurface, rotation: Array) -> Tensor:
        """Light (N,) on a vehicle's surface.

        Sky from above, what a roof lets in from the sides, what the ground sends back, and the sun.

        Args:
            rotation: (3, 3) `world_from_actor`.
        """
        turned = rotate_harmonics(
            self._harmonics[None, :, None], torch.from_numpy(rotation.T.copy())
        )
        facing = (surface.harmonics @ turned[0].to(surface.normals)).clamp(min=0)[:, 0]
        up = surface.normals @ torch.from_numpy(rotation[2]).to(surface.normals)
        shares = torch.from_numpy(np.stack([place.sky, place.sun], axis=-1)).to(surface.normals)
        sky, sun = (surface.stations @ shares).unbind(-1)
        beside = _BESIDE * (1 - sky) * (1 - up.square())
        ground = _BOUNCE * (sky + self.sun_on_ground * sun)
        return sky * (0.5 + 0.5 * up) + beside + ground * (0.5 - 0.5 * up) + sun * facing

    def explain(self) -> str:
        """A few lines for people."""
        if self.sunlit is None:
            road = "no road was seen: light depends on the heading, not on the place"
        else:
            road = f"road in the sun has a linear brightness of {self.sunlit:.3f}"
        return "\n".join([self.sun.explain(), road])


def _sky_radiance(scene: StreetScene) -> float:
    """Mean linear light of the sky's band above the horizon, which the log's cameras saw."""
    rows = scene.sky.colours.shape[0]
    elevation = np.pi / 2 - (np.arange(rows) + 0.5) * np.pi / rows
    band = (elevation > _SKY_BAND[0]) & (elevation < _SKY_BAND[1])
    return float(gamma_to_linear(scene.sky.colours.cpu().numpy()[band].astype(np.float64)).mean())


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
_FAINTEST, _DEEPEST = 0.015, 0.97
_TURN = np.radians(30.0)  # of a vehicle, after which its shadow lies elsewhere

COAT = 0.04
"""Reflectance of clear coat and glass at normal incidence."""
_MOST_MIRRORED = 0.5  # of a colour; the rest is paint, even on black
_DARKENING, _BRIGHTENING = 0.9, 0.3
"""Powers of the ratio of light, new over old. What gets brighter is trusted less: cameras flatten
what is bright, and generators know usual light: their shaded colours are not as dark as shade."""
_RATIO = (0.1, 6.0)
_LEAST_LIT = 0.02  # display value


@dataclass(frozen=True)
class SeenShadow:
    """The shadow that images of a vehicle show, and where it stood then.

    Attributes:
        sheet: level Gaussians, actor frame.
        yaws: (P,) headings in the world, radians.
        sun: mean light of the sun on what faces it, see `PlaceLight`.
    """

    sheet: Gaussians
    yaws: Array
    sun: float

    def share(self, place: PlaceLight, yaw: float) -> float:
        """How far it holds elsewhere: 1 for its heading and light, 0 after a turn of 30 degrees."""
        turn = np.abs((self.yaws - yaw + np.pi) % (2 * np.pi) - np.pi).min()
        sun = float(place.sun.mean()) + 1.0  # the sky is a unit of light, too
        same = min(sun, self.sun + 1.0) / max(sun, self.sun + 1.0)
        return float(max(1 - turn / _TURN, 0.0) * same)


def darkened(shadow: Gaussians, factor: float) -> Gaussians:
    """A shadow with its opacities times a factor."""
    opacities = (shadow.logit_opacities.sigmoid() * factor).clamp(1e-6, 1 - 1e-4)
    return replace(shadow, logit_opacities=opacities.logit())


class ActorLight:
    """What is needed to light a vehicle anew: a `recast.scene.actor.Lighting`.

    Args:
        scene: light of the street.
        gaussians: the vehicle, actor frame, in the light that it was recorded in.
        surface: normals and places of the Gaussians.
        recorded: (N,) float32 light that each Gaussian's colour was recorded in.
        shadow: what makes the shadow; None if the vehicle has none.
        seen: the shadow that images show; it takes the place of `shadow` where it holds.
    """

    def __init__(
        self,
        scene: SceneLight,
        gaussians: Gaussians,
        surface: LitSurface,
        recorded: Tensor,
        shadow: CastShadow | None,
        seen: SeenShadow | None = None,
    ) -> None:
        self.scene, self.surface, self.recorded = scene, surface, recorded
        self.shadow, self.seen = shadow, seen
        self._paint = Paint(gaussians, COAT * scene.sky_radiance)

    @property
    def shadow_room(self) -> int:
        """Most Gaussians that the shadow has."""
        seen = 0 if self.seen is None else len(self.seen.sheet)
        return seen + (0 if self.shadow is None else self.shadow.room)

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
            share = 0.0 if self.seen is None else self.seen.share(place, yaw)
            if self.seen is not None and share > 0:
                shadow = concatenate(
                    [darkened(shadow, 1 - share), darkened(self.seen.sheet, share)]
                )
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

    def sheet(
        self, light: SceneLight, place: PlaceLight, yaw: float, whole: bool = False
    ) -> Gaussians:
        """The shadow, actor frame.

        Args:
            yaw: heading of the vehicle in the world, radians.
            whole: whether places without shadow are in it, too.
        """
        hidden = _turned(light.sun.probability, yaw).astype(np.float32) @ self._sun
        sky = self._stations @ place.sky
        sun = _TOE * light.sun_on_ground * (self._stations @ place.sun)
        left = _left(sky, self._left, sun, hidden)
        dark = 1 - left ** (1 / GAMMA)
        kept = np.flatnonzero(whole | (dark > _FAINTEST))
        opacity = 1 - (1 - np.clip(dark[kept], _FAINTEST, _DEEPEST)) ** (1 / _OVERLAP)
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
