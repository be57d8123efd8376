"""The other vehicles: the target, seen from some sides only, and the traffic around it."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Literal

import numpy as np
from scipy.interpolate import PchipInterpolator

from recast.arrays import Array
from recast.dynamics.idm import IdmParameters, idm_acceleration
from recast.geometry import se2
from recast.logs import HdMap
from recast.synthetic.routes import (
    CENTRE_OFFSET,
    EGO_LENGTH,
    EGO_WIDTH,
    EgoDrive,
    RoutePath,
    SpeedProfile,
    beside,
    random_route,
    speed_profile,
)
from recast.synthetic.world import ParkingSpot, Street, VehicleModel, hiding, touching

Manner = Literal["leading", "overtaking", "passed"]
"""Ahead in the ego's lane, or in the next lane: falling ahead, or falling behind."""

MANNERS: Mapping[str, Manner] = {
    "urban-straight": "overtaking",
    "arterial-median": "passed",
    "underpass": "overtaking",
}
"""By scene; "leading" where not named, and where no lane lies beside."""

TARGET_KINDS = ("hatchback", "sedan", "estate", "suv")

_NEAR, _FAR = 6.5, 27.0
"""Metres along the road from the rig to the target's middle in the next lane."""
_RELATIVE_SPEED = 2.6
_LEAD, _LEAD_NEAREST = 15.0, 10.5
"""The same in the ego's own lane: on average, and never less."""
_LEAD_WAVE = 0.06
_WHEELBASE_SHARE = 0.58
_DRIVER = IdmParameters(min_gap=3.0, headway=1.2, max_acceleration=1.2, max_deceleration=2.5)
_DRIVING_MARGIN, _PARKED_MARGIN = 0.7, 0.25
_AHEAD_MARGIN = 3.0
"""Metres kept free around the ego's ends, beyond the margin on all sides."""
_AHEAD_SECONDS = 0.5
"""Of driving, kept free before and behind a moving vehicle."""
_SAME_LANE = 1.8
_SEEN = (70.0, np.deg2rad(65), 0.3)
_CROSSING_DISTANCE, _CROSSING_ANGLE = 2.0, np.deg2rad(30)
_SPEED_SHARE = (0.8, 1.05)
_PARKED_WITHIN = 55.0
_TIGHT = 0.2
"""Metres that a parking spot must be longer than the car."""


@dataclass(frozen=True)
class TargetDrive:
    """How the target drives.

    Attributes:
        manner: what was possible, see `Manner`.
        path: path of the target's middle.
        place: (T,) metres along the path.
    """

    manner: Manner
    path: RoutePath
    place: Array

    def poses(self, length: float) -> Array:
        """(T, 3) planar poses of the middle of a vehicle of this length."""
        return self.path.poses(self.place, wheelbase(length))


def wheelbase(length: float) -> float:
    """Metres between the axles of a vehicle of some length."""
    return _WHEELBASE_SHARE * length


def target_drive(
    street_map: HdMap, ego: EgoDrive, manner: Manner, rng: np.random.Generator
) -> TargetDrive:
    """The target's drive: the ego's own, some seconds ahead.

    It passes every place at about the speed of the ego there, so it slows down for the same bends.
    The lead in seconds changes with time.
    """
    for side in ("left", "right") if manner != "leading" else ():
        lanes = beside(street_map, ego.path.lanes, side)
        if lanes is None:
            continue
        path = RoutePath.along(street_map, lanes)
        place = _in_next_lane(path, ego, manner)
        if place is not None:
            return TargetDrive(manner, path, place)
    return TargetDrive("leading", ego.path, _leading(ego, rng))


def _leading(ego: EgoDrive, rng: np.random.Generator) -> Array:
    """At the shortest lead that never comes too near, but on average not below the usual."""
    wave = np.sin(2 * np.pi * (ego.seconds / rng.uniform(9.0, 14.0) + rng.uniform()))
    lead = _LEAD / ego.mean_speed
    while True:
        place = ego.place(ego.seconds + lead * (1 + _LEAD_WAVE * wave))
        if (place - ego.place(ego.seconds)).min() >= _LEAD_NEAREST:
            return place
        lead += 0.05


def _in_next_lane(path: RoutePath, ego: EgoDrive, manner: Manner) -> Array | None:
    """Places on the lane beside the ego's, or None where that lane is too short."""
    seconds = ego.seconds
    change = min(_FAR - _NEAR, _RELATIVE_SPEED * float(seconds[-1]))
    ahead = _NEAR + change * seconds / seconds[-1]
    if manner == "passed":
        ahead = ahead[::-1]
    lead = ahead / ego.mean_speed
    wanted = ego.place(seconds + lead)
    marks = np.arange(0.0, ego.path.length, 4.0)
    beside_marks, lateral = path.line.to_frenet(ego.path.position(marks))
    inside = (beside_marks > 0.1) & (beside_marks < path.length - 0.1) & (np.abs(lateral) < 8.0)
    marks, beside_marks = marks[inside], beside_marks[inside]
    if len(marks) < 2 or np.any(np.diff(beside_marks) <= 0):
        return None
    if wanted.min() < marks[0] + CENTRE_OFFSET or wanted.max() > marks[-1] - 5.0:
        return None
    return PchipInterpolator(marks, beside_marks)(wanted)


@dataclass(frozen=True)
class PlacedVehicle:
    """A vehicle with its poses.

    Attributes:
        model: its shape.
        poses: (T, 3) planar poses of its middle.
    """

    model: VehicleModel
    poses: Array


@dataclass(frozen=True)
class TrafficScene:
    """What a new vehicle has to get on with.

    Attributes:
        street: lanes and parking.
        ego: the ego's drive.
        target: the vehicle not to hide.
    """

    street: Street
    ego: EgoDrive
    target: PlacedVehicle

    def fits(self, new: PlacedVehicle, others: Sequence[PlacedVehicle], margin: float) -> bool:
        """Whether `new` touches nobody and hides nothing of the target."""
        size = new.model.size
        footprints = [(self.ego.outline, np.array([EGO_LENGTH + _AHEAD_MARGIN, EGO_WIDTH]))]
        footprints += [(placed.poses, placed.model.size) for placed in (self.target, *others)]
        for poses, other in footprints:
            if touching(new.poses, size, poses, other, margin).any():
                return False
        eyes = self.ego.outline[:, :2]
        target = self.target
        hidden = hiding(eyes, target.poses, target.model.size, new.poses, size)
        return not hidden.any()


def try_driving(
    scene: TrafficScene,
    model: VehicleModel,
    others: Sequence[PlacedVehicle],
    rng: np.random.Generator,
) -> PlacedVehicle | None:
    """A random drive for `model`, or None where the one drawn is not possible or never seen."""
    lanes = scene.street.map.lanes
    first = sorted(lanes)[int(rng.integers(len(lanes)))]
    seconds = scene.ego.seconds
    reach = 1.2 * scene.street.ego_speed * float(seconds[-1]) + 40.0
    route = random_route(scene.street.map, first, reach, rng)
    path = RoutePath.along(scene.street.map, route)
    half = float(model.size[0]) / 2
    first_length = RoutePath.along(scene.street.map, [first]).length
    start = half + rng.uniform() * max(first_length - 2 * half, 0.0)
    profile = speed_profile(path, scene.street.ego_speed * rng.uniform(*_SPEED_SHARE), rng)
    if _crosses(path, scene.ego.path):
        return None
    place = _follow(path, profile, start, model, scene, others)
    if place[0] < half or place[-1] > path.length - half:
        return None
    poses = path.poses(place, wheelbase(float(model.size[0])))
    if not is_seen(poses, scene.ego.poses, *_SEEN):
        return None
    mean_speed = float(place[-1] - place[0]) / float(seconds[-1])
    longer = model.size + np.array([2 * _AHEAD_SECONDS * mean_speed, 0.0, 0.0])
    spacious = VehicleModel(model.kind, model.category, model.colour, longer, model.surface)
    if not scene.fits(PlacedVehicle(spacious, poses), others, _DRIVING_MARGIN):
        return None
    return PlacedVehicle(model, poses)


def try_parking(
    scene: TrafficScene, spot: ParkingSpot, model: VehicleModel, others: Sequence[PlacedVehicle]
) -> PlacedVehicle | None:
    """`model` parked at `spot`, or None where it does not fit."""
    if model.size[0] > spot.length - _TIGHT:
        return None
    pose = np.array([spot.x, spot.y, spot.heading])
    placed = PlacedVehicle(model, np.repeat(pose[None], len(scene.ego.seconds), axis=0))
    return placed if scene.fits(placed, others, _PARKED_MARGIN) else None


def near_spots(scene: TrafficScene) -> list[ParkingSpot]:
    """Parking spots near what the ego drives along, nearest to its start first."""
    drive = scene.ego
    s = np.linspace(drive.place(0.0) - 15.0, drive.place(drive.seconds[-1]) + 40.0, 200)
    road = drive.path.position(np.clip(s, 0.0, drive.path.length))
    found = []
    for number, spot in enumerate(scene.street.parking):
        distance = np.hypot(*(road - [spot.x, spot.y]).T)
        if distance.min() <= _PARKED_WITHIN:
            found.append((int(np.argmin(distance)), number, spot))
    return [spot for _, _, spot in sorted(found, key=lambda entry: entry[:2])]


def _follow(
    path: RoutePath,
    profile: SpeedProfile,
    start: float,
    model: VehicleModel,
    scene: TrafficScene,
    others: Sequence[PlacedVehicle],
) -> Array:
    """Places (T,) of a driver who keeps behind whoever is ahead on `path` (IDM)."""
    seconds = scene.ego.seconds
    leads = [(scene.ego.outline, EGO_LENGTH)]
    leads += [(o.poses, float(o.model.size[0])) for o in (scene.target, *others)]
    ahead, speeds = [], []
    for poses, length in leads:
        s, lateral = path.line.to_frenet(poses[:, :2])
        turn = np.abs(se2.wrap_angle(poses[:, 2] - path.heading(s)))
        on_path = (np.abs(lateral) < _SAME_LANE) & (turn < np.pi / 3)
        gap_off = (length + float(model.size[0])) / 2
        ahead.append(np.where(on_path, s - gap_off, np.inf))
        speeds.append(np.gradient(s, seconds))
    rear, speed_ahead = np.array(ahead), np.array(speeds)
    place = np.empty(len(seconds))
    place[0], speed = start, float(profile.at(start))
    for k, step in enumerate(np.diff(seconds)):
        gaps = np.where(rear[:, k] > place[k] - float(model.size[0]) / 2, rear[:, k], np.inf)
        lead = int(np.argmin(gaps))
        acceleration = float(
            idm_acceleration(
                speed, profile.at(place[k]), gaps[lead] - place[k], speed_ahead[lead, k], _DRIVER
            )
        )
        faster = max(speed + acceleration * step, 0.0)
        place[k + 1] = place[k] + (speed + faster) / 2 * step
        speed = faster
    return place


def _crosses(path: RoutePath, other: RoutePath) -> bool:
    """Whether a path cuts another at an angle: traffic there would have to give way."""
    s = np.arange(0.0, path.length, 1.0)
    points = path.position(s)
    nearest, lateral = other.line.to_frenet(points)
    turn = np.abs(se2.wrap_angle(path.heading(s) - other.heading(nearest)))
    near = np.abs(lateral) < _CROSSING_DISTANCE
    inside = (nearest > 0) & (nearest < other.length)
    across = (turn > _CROSSING_ANGLE) & (turn < np.pi - _CROSSING_ANGLE / 2)
    return bool(np.any(near & inside & across))


def is_seen(poses: Array, rig: Array, within: float, field: float, share: float) -> bool:
    """Whether it is in front of the ego for a share of the time.

    In front is within some metres, and some radians of straight ahead.
    """
    seen = se2.relative(rig, poses)
    distance, bearing = np.hypot(seen[:, 0], seen[:, 1]), np.arctan2(seen[:, 1], seen[:, 0])
    return bool(((distance < within) & (np.abs(bearing) < field)).mean() >= share)
