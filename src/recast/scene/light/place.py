"""The light of a place in a reconstructed street, told by the street alone."""

from __future__ import annotations

from dataclasses import dataclass, replace
from functools import cached_property
from typing import Self

import numpy as np
import torch
from numpy.typing import NDArray
from scipy.spatial import cKDTree
from torch import Tensor

from recast.arrays import Array
from recast.geometry import se3
from recast.geometry.colour import gamma_to_linear
from recast.scene.light.sun import SUN_OVER_SKY, Patches, SunBelief, find_sun, street_surfaces
from recast.scene.street_scene import StreetScene
from recast.splats.sh import basis, rotate

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
        """Of points (N, 3) with normals (N, 3), actor frame, on a vehicle of `size` (3,)."""
        shares = near_stations(points[:, 0].detach().cpu().numpy().astype(np.float64), size)
        return cls(normals, basis(normals, 2), torch.from_numpy(shares).to(normals))


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
        return float(basis(up, 2) @ self._harmonics)

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
        turned = rotate(self._harmonics[None, :, None], torch.from_numpy(rotation.T.copy()))
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
