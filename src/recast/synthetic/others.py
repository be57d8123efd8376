"""The other vehicles: some drive, some are parked. None touches another or hides the target."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from recast.dynamics.idm import IdmParameters, idm_acceleration
from recast.geometry import se2
from recast.synthetic import clearance, ego
from recast.synthetic.lane_path import LanePath
from recast.synthetic.routes import random_route
from recast.synthetic.speed import SpeedProfile, speed_profile
from recast.synthetic.target import wheelbase
from recast.synthetic.world import ParkingSpot, Street, VehicleModel

Array = NDArray[np.float64]

_DRIVER = IdmParameters(min_gap=3.0, headway=1.2, max_acceleration=1.2, max_deceleration=2.5)
_DRIVING_MARGIN, _PARKED_MARGIN = 0.7, 0.25
_AHEAD_MARGIN = 3.0
"""Metres kept free around the ego's ends, beyond the margin on all sides."""
_AHEAD_SECONDS = 0.5
"""Of driving, kept free before and behind a moving vehicle."""
_SAME_LANE = 1.8
_SEEN_WITHIN = 70.0
_SEEN_FIELD = np.deg2rad(65)
_SEEN_SHARE = 0.3
_CROSSING_DISTANCE, _CROSSING_ANGLE = 2.0, np.deg2rad(30)
_SPEED_SHARE = (0.8, 1.05)
_PARKED_WITHIN = 55.0
_TIGHT = 0.2
"""Metres that a parking spot must be longer than the car."""


@dataclass(frozen=True)
class Placed:
    """A vehicle with its poses.

    Attributes:
        model: its shape.
        poses: (T, 3) planar poses of its middle.
    """

    model: VehicleModel
    poses: Array


@dataclass(frozen=True)
class Scene:
    """What a new vehicle has to get on with.

    Attributes:
        street: lanes and parking.
        ego: the ego's drive.
        target: the vehicle not to hide.
    """

    street: Street
    ego: ego.EgoDrive
    target: Placed

    def fits(self, new: Placed, others: Sequence[Placed], margin: float) -> bool:
        """Whether `new` touches nobody and hides nothing of the target."""
        size = new.model.size
        footprints = [(self.ego.outline, np.array([ego.LENGTH + _AHEAD_MARGIN, ego.WIDTH]))]
        footprints += [(placed.poses, placed.model.size) for placed in (self.target, *others)]
        for poses, other in footprints:
            if clearance.touching(new.poses, size, poses, other, margin).any():
                return False
        eyes = self.ego.outline[:, :2]
        target = self.target
        hidden = clearance.hiding(eyes, target.poses, target.model.size, new.poses, size)
        return not hidden.any()


def try_driving(
    scene: Scene, model: VehicleModel, others: Sequence[Placed], rng: np.random.Generator
) -> Placed | None:
    """A random drive for `model`, or None where the one drawn is not possible or never seen."""
    lanes = scene.street.map.lanes
    first = sorted(lanes)[int(rng.integers(len(lanes)))]
    seconds = scene.ego.seconds
    reach = 1.2 * scene.street.ego_speed * float(seconds[-1]) + 40.0
    route = random_route(scene.street.map, first, reach, rng)
    path = LanePath.along(scene.street.map, route)
    half = float(model.size[0]) / 2
    first_length = LanePath.along(scene.street.map, [first]).length
    start = half + rng.uniform() * max(first_length - 2 * half, 0.0)
    profile = speed_profile(path, scene.street.ego_speed * rng.uniform(*_SPEED_SHARE), rng)
    if _crosses(path, scene.ego.path):
        return None
    place = _follow(path, profile, start, model, scene, others)
    if place[0] < half or place[-1] > path.length - half:
        return None
    poses = path.poses(place, wheelbase(float(model.size[0])))
    if not _is_seen(poses, scene.ego.poses):
        return None
    mean_speed = float(place[-1] - place[0]) / float(seconds[-1])
    longer = model.size + np.array([2 * _AHEAD_SECONDS * mean_speed, 0.0, 0.0])
    spacious = VehicleModel(model.kind, model.category, model.colour, longer, model.surface)
    if not scene.fits(Placed(spacious, poses), others, _DRIVING_MARGIN):
        return None
    return Placed(model, poses)


def try_parking(
    scene: Scene, spot: ParkingSpot, model: VehicleModel, others: Sequence[Placed]
) -> Placed | None:
    """`model` parked at `spot`, or None where it does not fit."""
    if model.size[0] > spot.length - _TIGHT:
        return None
    pose = np.array([spot.x, spot.y, spot.heading])
    placed = Placed(model, np.repeat(pose[None], len(scene.ego.seconds), axis=0))
    return placed if scene.fits(placed, others, _PARKED_MARGIN) else None


def near_spots(scene: Scene) -> list[ParkingSpot]:
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
    path: LanePath,
    profile: SpeedProfile,
    start: float,
    model: VehicleModel,
    scene: Scene,
    others: Sequence[Placed],
) -> Array:
    """Places (T,) of a driver who keeps behind whoever is ahead on `path` (IDM)."""
    seconds = scene.ego.seconds
    leads = [(scene.ego.outline, ego.LENGTH)]
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


def _crosses(path: LanePath, other: LanePath) -> bool:
    """Whether a path cuts another at an angle: traffic there would have to give way."""
    s = np.arange(0.0, path.length, 1.0)
    points = path.position(s)
    nearest, lateral = other.line.to_frenet(points)
    turn = np.abs(se2.wrap_angle(path.heading(s) - other.heading(nearest)))
    near = np.abs(lateral) < _CROSSING_DISTANCE
    inside = (nearest > 0) & (nearest < other.length)
    across = (turn > _CROSSING_ANGLE) & (turn < np.pi - _CROSSING_ANGLE / 2)
    return bool(np.any(near & inside & across))


def _is_seen(poses: Array, rig: Array) -> bool:
    """Whether it is in front of the ego and not far for some of the time."""
    seen = se2.relative(rig, poses)
    distance, bearing = np.hypot(seen[:, 0], seen[:, 1]), np.arctan2(seen[:, 1], seen[:, 0])
    visible = (distance < _SEEN_WITHIN) & (np.abs(bearing) < _SEEN_FIELD)
    return bool(visible.mean() >= _SEEN_SHARE)
