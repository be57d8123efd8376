"""The whole of a synthetic drive: street, light, vehicles, and the ego's path."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from functools import cached_property
from typing import Literal, Protocol

import numpy as np
from numpy.typing import NDArray

from recast.geometry import Polyline
from recast.logs import HdMap, Trajectory
from recast.synthetic.surface import Surface

Array = NDArray[np.float64]

Quality = Literal["standard", "mitsuba"]
"""Where the light of the sky comes from: one bounce of our own, or mitsuba's path tracer."""


@dataclass(frozen=True)
class Sky:
    """Daylight.

    Attributes:
        sun_direction: (3,) unit vector towards the sun, world frame.
        sun: (3,) linear RGB irradiance on a surface that faces the sun.
        zenith, horizon: (3,) linear RGB radiance of the sky overhead and at the horizon.
        sun_radius: radians of the disc that casts soft shadows.
        clouds: cover in [0, 1].
        seed: of the cloud pattern.
    """

    sun_direction: Array
    sun: Array
    zenith: Array
    horizon: Array
    sun_radius: float = 0.01
    clouds: float = 0.3
    seed: int = 0


@dataclass(frozen=True)
class ParkingSpot:
    """Where a car may stand.

    Attributes:
        x, y, heading: of the box centre, world frame, radians.
        length: metres that a vehicle there may have.
    """

    x: float
    y: float
    heading: float
    length: float = 5.2


@dataclass(frozen=True)
class Street:
    """Everything that never moves.

    Attributes:
        kind: name of the scene, such as "urban-straight".
        surface: triangles in the world frame, ground at z = 0 on the road.
        map: lanes, drivable area, ground.
        ego_route: lane ids in the order of driving.
        ego_speed: m/s that the ego keeps on a free road.
        parking: spots for parked cars.
        sky: daylight.
    """

    kind: str
    surface: Surface
    map: HdMap
    ego_route: tuple[str, ...]
    ego_speed: float
    parking: tuple[ParkingSpot, ...]
    sky: Sky


class Articulation(Protocol):
    """How a shape changes with the way that it has gone: legs that walk, wheels that turn."""

    def surface_at(self, travelled: float) -> Surface:
        """Triangles in the actor-local frame after `travelled` metres, always the same number."""


@dataclass(frozen=True)
class VehicleModel:
    """One vehicle or person as a shape.

    Attributes:
        kind: "hatchback", "sedan", "estate", "suv", "pickup", "van", "box-truck" or "bus";
            "pedestrian" or "cyclist".
        category: of the label, see `recast.logs.Track`.
        colour: name, such as "white".
        size: (3,) length, width, height of the box around it, metres; mirrors not counted.
        surface: triangles in the actor-local frame: origin at the box centre, x forward, y left,
            z up, the tyres or feet standing on z = -height / 2.
        articulation: how the surface changes with the way; None for a rigid vehicle.
    """

    kind: str
    category: str
    colour: str
    size: Array
    surface: Surface
    articulation: Articulation | None = None


@dataclass(frozen=True)
class Vehicle:
    """One vehicle or person in the world.

    Attributes:
        track_id: unique in the world.
        model: its shape.
        trajectory: `world_from_actor` at the times of the log.
        parked: never moves in the log.
    """

    track_id: str
    model: VehicleModel
    trajectory: Trajectory
    parked: bool

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
