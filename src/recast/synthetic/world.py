"""The whole of a synthetic drive: street, light, vehicles and ego, and who hides whom."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from functools import cached_property
from typing import Literal, Protocol

import numpy as np
import shapely
from numpy.random import Generator
from numpy.typing import ArrayLike, NDArray

from recast.arrays import Array
from recast.geometry import Polyline, boxes
from recast.logs import HdMap, Trajectory
from recast.synthetic.surface import Surface

Quality = Literal["standard", "mitsuba"]
"""Where the light of the sky comes from: one bounce of our own, or mitsuba's path tracer."""
Times = NDArray[np.bool_]


@dataclass(frozen=True)
class Sky:
    """Daylight."""

    sun_direction: Array  # (3,) unit vector towards the sun, world frame
    sun: Array  # (3,) linear RGB irradiance on a surface that faces the sun
    # zenith, horizon: (3,) linear RGB radiance of the sky overhead and at the horizon.
    zenith: Array
    horizon: Array
    sun_radius: float = 0.01  # radius, in radians, of the disc that casts soft shadows
    clouds: float = 0.3  # cloud cover in [0, 1]
    seed: int = 0  # seed of the cloud pattern


@dataclass(frozen=True)
class ParkingSpot:
    """Where a car may stand."""

    # x, y, heading: place and heading of the box centre, world frame, metres and radians.
    x: float
    y: float
    heading: float
    length: float = 5.2  # metres that a vehicle there may have


@dataclass(frozen=True)
class Street:
    """Everything that never moves."""

    kind: str  # name of the scene, such as "urban-straight"
    surface: Surface  # triangles in the world frame, ground at z = 0 on the road
    map: HdMap  # lanes, drivable area, ground
    ego_route: tuple[str, ...]  # lane ids in the order of driving
    ego_speed: float  # m/s that the ego keeps on a free road
    parking: tuple[ParkingSpot, ...]  # spots for parked cars
    sky: Sky  # daylight


class Articulation(Protocol):
    """How a shape changes with the way that it has gone: legs that walk, wheels that turn."""

    def surface_at(self, travelled: float) -> Surface:
        """Triangles in the actor-local frame after `travelled` metres, always the same number."""


@dataclass(frozen=True)
class VehicleModel:
    """One vehicle or person as a shape."""

    # "hatchback", "sedan", "estate", "suv", "pickup", "van", "box-truck" or "bus"; "pedestrian" or
    # "cyclist".
    kind: str
    category: str  # category of the label, see `recast.logs.Track`
    colour: str  # name, such as "white"
    size: Array  # (3,) length, width, height of the box around it, metres; mirrors not counted
    # triangles in the actor-local frame: origin at the box centre, x forward, y left, z up, the
    # tyres or feet standing on z = -height / 2.
    surface: Surface
    # how the surface changes with the way; None for a rigid vehicle.
    articulation: Articulation | None = None


@dataclass(frozen=True)
class Vehicle:
    """One vehicle or person in the world."""

    track_id: str  # track id, unique in the world
    model: VehicleModel  # its shape
    trajectory: Trajectory  # `world_from_actor` at the times of the log
    parked: bool  # never moves in the log

    def surface_at(self, pose: Array) -> Surface:
        """Triangles in the actor-local frame when it is at `pose` (4, 4) `world_from_actor`.

        What is articulated has the shape of the place on its own way that is nearest to the pose.
        """
        if self.model.articulation is None:
            return self.model.surface
        travelled, _ = self._way.to_frenet(pose[:2, 3])
        return self.model.articulation.surface_at(float(travelled))

    @cached_property
    def _way(self) -> Polyline:
        return Polyline.from_points(self.trajectory.poses[:, :2, 3])


@dataclass(frozen=True)
class World:
    """A drive that can be looked at from anywhere.

    Attributes:
        name, seed, seconds, people: give this world again, see `make_world`.
        street: what never moves.
        vehicles: vehicles and people by track id, the ego not among them.
        ego: `world_from_rig`.
        target: track id of the vehicle that the scene was made to ask about.
        light: how cameras are lit, in the log and by the oracle.
        people: whether pedestrians and cyclists are among the vehicles.
    """

    name: str
    seed: int
    seconds: float
    street: Street
    vehicles: Mapping[str, Vehicle]
    ego: Trajectory
    target: str
    light: Quality = "standard"
    people: bool = False


def touching(
    poses_a: Array, size_a: ArrayLike, poses_b: Array, size_b: ArrayLike, margin: float = 0.0
) -> Times:
    """At which times (T,) two rectangles come closer than about `margin` metres.

    They are given by planar poses (T, 3) of their centres and (length, width) in metres.
    """
    grown_a, grown_b = (np.asarray(s, np.float64)[:2] + margin for s in (size_a, size_b))
    return boxes.bev_touching(poses_a, grown_a, poses_b, grown_b)


def hiding(
    eyes: Array, target: Array, target_size: ArrayLike, other: Array, other_size: ArrayLike
) -> Times:
    """At which times (T,) `other` cuts a sight line from `eyes` (T, 2) to the target's box."""
    outline, wall = (
        boxes.bev_corners(poses, *np.asarray(size, np.float64)[:2])
        for poses, size in ((target, target_size), (other, other_size))
    )
    ends = np.concatenate([outline, target[:, None, :2]], axis=1)
    sight = shapely.linestrings(np.stack(np.broadcast_arrays(eyes[:, None], ends), axis=2))
    return np.any(shapely.intersects(sight, shapely.polygons(wall)[:, None]), axis=1)


def daylight(rng: Generator, elevation: tuple[float, float] = (25.0, 60.0)) -> Sky:
    """A sky drawn from fair to overcast; the lower the sun, the warmer and weaker its light.

    Args:
        rng: source of the draw.
        elevation: degrees between which the sun stands.
    """
    azimuth = rng.uniform(0.0, 2 * np.pi)
    high = np.deg2rad(rng.uniform(*elevation))
    clouds = float(rng.choice([rng.uniform(0.05, 0.35), rng.uniform(0.35, 0.75)], p=[0.65, 0.35]))
    haze = rng.uniform(0.0, 1.0)
    direction = np.array(
        [np.cos(azimuth) * np.cos(high), np.sin(azimuth) * np.cos(high), np.sin(high)]
    )
    low = np.exp(-np.sin(high) / 0.35)  # path through the air
    strength = (1 - 0.55 * clouds**2) * (1 - 0.15 * haze)
    sun = strength * 5.0 * np.array([1.0, 1.0 - 0.16 * low, 0.94 - 0.42 * low]) * (1 - 0.3 * low)
    grey = np.array([0.62, 0.66, 0.72])
    clear = np.array([0.23, 0.36, 0.62])
    zenith = (1 - 0.6 * clouds) * clear + 0.6 * clouds * grey
    pale = np.array([0.66, 0.76, 0.88])
    horizon = (1 - 0.5 * haze) * pale + 0.5 * haze * np.array([0.85, 0.85, 0.84])
    return Sky(
        sun_direction=direction,
        sun=sun,
        zenith=zenith,
        horizon=horizon,
        sun_radius=float(0.006 + 0.03 * clouds),
        clouds=clouds,
        seed=int(rng.integers(2**31)),
    )
