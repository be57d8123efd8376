"""Drives along lanes: the route, the smooth path on it, its speed, and the ego."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from functools import cached_property
from typing import Literal

import numpy as np
from numpy.typing import ArrayLike
from scipy.interpolate import CubicSpline, PchipInterpolator
from scipy.ndimage import gaussian_filter1d

from recast.arrays import Array
from recast.core.errors import InputError
from recast.dynamics.state import IdmParameters, idm_acceleration
from recast.geometry import Polyline, se2
from recast.logs import HdMap
from recast.synthetic.streets import EGO_START
from recast.synthetic.world import ParkingSpot, Street, VehicleModel, hiding, touching

_SPACING = 0.5
_SMOOTHING = 1.5
"""Metres (standard deviation) over which corners of centrelines are rounded."""
_EXTENSION = 12.0
"""Metres added straight at both ends for the smoothing, and taken off again."""
Side = Literal["left", "right"]

_MAX_LANES = 50
LATERAL_LIMIT = 2.0
"""m/s^2 that no driver exceeds; profiles aim at less, for what smoothing adds."""
_LATERAL_AIM = 1.6
_SPEEDING_UP, _SLOWING_DOWN = 1.0, 1.3

_SPEED_SMOOTHING = 2.0
_UNEVENNESS = 0.05
_FINER = 20
EGO_LENGTH, EGO_WIDTH, CENTRE_OFFSET = 5.176, 2.297, 1.461
"""Outline of the ego, and how far its middle is ahead of the rear axle, metres; nuPlan's car."""

_ROAD_AHEAD = 60.0
"""Metres of road needed past the end of a drive, for vehicles ahead of the ego."""


@dataclass(frozen=True)
class RoutePath:
    """A path with continuous heading and curvature."""

    lanes: tuple[str, ...]  # the lanes it follows, in order
    line: Polyline  # its points, 0.5 m apart

    @classmethod
    def along(cls, street_map: HdMap, lanes: Sequence[str]) -> RoutePath:
        """The rounded centreline of successive lanes. Raises ValueError: the lanes hold fewer than
        two distinct points."""
        points = np.concatenate([street_map.lanes[name].centreline[:, :2] for name in lanes])
        raw = Polyline.from_points(points, min_step=0.05)
        count = int(np.ceil((raw.length + 2 * _EXTENSION) / _SPACING))
        s = np.linspace(-_EXTENSION, raw.length + _EXTENSION, count + 1)
        sigma = _SMOOTHING / (s[1] - s[0])
        smooth = gaussian_filter1d(raw.position(s), sigma, axis=0, mode="nearest")
        inside = (s >= 0) & (s <= raw.length)
        return cls(tuple(lanes), Polyline(smooth[inside]))

    @property
    def length(self) -> float:
        """Metres."""
        return self.line.length

    @cached_property
    def _spline(self) -> CubicSpline:
        return CubicSpline(self.line.arc_lengths, self.line.points)

    def position(self, s: ArrayLike) -> Array:
        """Points (..., 2) at arc lengths (...) within [0, length]."""
        return self._spline(np.asarray(s, np.float64))

    def heading(self, s: ArrayLike) -> Array:
        """Tangent heading (...), radians."""
        tangent = self._spline(np.asarray(s, np.float64), 1)
        return np.arctan2(tangent[..., 1], tangent[..., 0])

    def curvature(self, s: ArrayLike) -> Array:
        """Signed curvature (...), 1/m, positive to the left."""
        s = np.asarray(s, np.float64)
        (dx, dy), (ddx, ddy) = (np.moveaxis(self._spline(s, order), -1, 0) for order in (1, 2))
        return (dx * ddy - dy * ddx) / np.hypot(dx, dy) ** 3

    def poses(self, s: ArrayLike, wheelbase: float = 0.0) -> Array:
        """Planar poses (..., 3) of a vehicle whose middle is at s.

        Args:
            wheelbase: both axles are on the path, this many metres apart; 0 for the tangent.
        """
        s = np.asarray(s, np.float64)
        if wheelbase <= 0:
            return np.concatenate([self.position(s), self.heading(s)[..., None]], axis=-1)
        rear, front = self.position(s - wheelbase / 2), self.position(s + wheelbase / 2)
        axis = front - rear
        heading = np.arctan2(axis[..., 1], axis[..., 0])
        return np.concatenate([(rear + front) / 2, heading[..., None]], axis=-1)


def extended_route(street_map: HdMap, route: Sequence[str]) -> tuple[str, ...]:
    """A route with all the road before and after it, straight on where the road forks."""
    lanes = list(route)
    while len(lanes) < _MAX_LANES:
        ahead = [k for k in street_map.lanes[lanes[-1]].successors if k not in lanes]
        if not ahead:
            break
        lanes.append(min(ahead, key=lambda key: (_turn(street_map, key), key)))
    while len(lanes) < _MAX_LANES:
        before = [key for key, lane in street_map.lanes.items() if lanes[0] in lane.successors]
        behind = [key for key in before if key not in lanes]
        if not behind:
            break
        lanes.insert(0, min(behind, key=lambda key: (_turn(street_map, key), key)))
    return tuple(lanes)


def random_route(
    street_map: HdMap, first: str, least_length: float, rng: np.random.Generator
) -> tuple[str, ...]:
    """A chain from `first`, with a random choice at forks, until it has the length or ends."""
    lanes, length = [first], _length(street_map, first)
    while length < least_length and len(lanes) < _MAX_LANES:
        ahead = sorted(k for k in street_map.lanes[lanes[-1]].successors if k not in lanes)
        if not ahead:
            break
        lanes.append(ahead[int(rng.integers(len(ahead)))])
        length += _length(street_map, lanes[-1])
    return tuple(lanes)


def beside(street_map: HdMap, route: Sequence[str], side: Side) -> tuple[str, ...] | None:
    """The chain of lanes next to a part of `route`, or None where there is none.

    Where the neighbour begins or ends along the route, the longest unbroken piece is taken.
    """
    best: list[str] = []
    piece: list[str] = []
    for key in route:
        lane = street_map.lanes[key]
        neighbour = lane.left_neighbour if side == "left" else lane.right_neighbour
        if neighbour is None:
            piece = []
            continue
        if piece and neighbour == piece[-1]:
            continue
        follows = bool(piece) and neighbour in street_map.lanes[piece[-1]].successors
        piece = [*piece, neighbour] if follows else [neighbour]
        if _total(street_map, piece) > _total(street_map, best):
            best = piece
    return tuple(best) or None


def _total(street_map: HdMap, lanes: Sequence[str]) -> float:
    return sum(_length(street_map, key) for key in lanes)


def _length(street_map: HdMap, lane: str) -> float:
    steps = np.diff(street_map.lanes[lane].centreline[:, :2], axis=0)
    return float(np.linalg.norm(steps, axis=1).sum())


def _turn(street_map: HdMap, lane: str) -> float:
    """How much a lane bends from its start to its end, radians, to the nearest degree."""
    path = RoutePath.along(street_map, [lane])
    turn = se2.wrap_angle(path.heading(path.length) - path.heading(0.0))
    return round(abs(float(np.rad2deg(turn))))


@dataclass(frozen=True)
class SpeedProfile:
    """Speed by place."""

    s: Array  # (N,) metres along the path, evenly spaced from 0
    speed: Array  # (N,) m/s, positive

    def at(self, s: ArrayLike) -> Array:
        """Speeds (...) at arc lengths (...)."""
        return np.interp(np.asarray(s, np.float64), self.s, self.speed)

    @cached_property
    def _clock(self) -> tuple[Array, Array]:
        """Places and the seconds at which a free drive from the path's start reaches them."""
        place = np.linspace(self.s[0], self.s[-1], _FINER * (len(self.s) - 1) + 1)
        slowness = 1 / self.at(place)
        spent = np.cumsum(np.diff(place) * (slowness[:-1] + slowness[1:]) / 2)
        return place, np.concatenate([[0.0], spent])

    def drive(self, start: float, seconds: ArrayLike) -> Array:
        """Arc lengths (...) reached `seconds` (...) after `start`; seconds may be negative.

        Beyond both ends of the path, the speed there is kept.
        """
        place, clock = self._clock
        times = np.interp(start, place, clock) + np.asarray(seconds, np.float64)
        reached = np.interp(times, clock, place)
        reached = reached + np.minimum(times, 0.0) * self.speed[0]
        return reached + np.maximum(times - clock[-1], 0.0) * self.speed[-1]


def speed_profile(path: RoutePath, cruise: float, rng: np.random.Generator) -> SpeedProfile:
    """A profile with lateral acceleration within 2 m/s^2 and gentle braking ahead of bends.

    Args:
        cruise: m/s on a straight free road; wavers by 5 %.
    """
    s = np.linspace(0.0, path.length, max(2, int(np.ceil(path.length / _SPACING)) + 1))
    step = s[1] - s[0]
    phase, wavelength = rng.uniform(0, 2 * np.pi), rng.uniform(60.0, 110.0)
    wanted = cruise * (1 + _UNEVENNESS * np.sin(2 * np.pi * s / wavelength + phase))
    bend = np.abs(path.curvature(s))
    square = np.minimum(wanted, np.sqrt(_LATERAL_AIM / np.maximum(bend, 1e-6))) ** 2
    for i in range(1, len(square)):
        square[i] = min(square[i], square[i - 1] + 2 * _SPEEDING_UP * step)
    for i in range(len(square) - 2, -1, -1):
        square[i] = min(square[i], square[i + 1] + 2 * _SLOWING_DOWN * step)
    speed = gaussian_filter1d(np.sqrt(square), _SPEED_SMOOTHING / step, mode="nearest")
    return SpeedProfile(s, speed)


@dataclass(frozen=True)
class EgoDrive:
    """A drive of the rear axle along a path."""

    path: RoutePath  # the route's centreline, with all the road before and after
    profile: SpeedProfile  # speed by place on it
    start: float  # metres along the path at time 0
    seconds: Array  # (T,) times of the log's poses

    def place(self, seconds: ArrayLike) -> Array:
        """Arc lengths (...) of the rear axle, also before and after the log."""
        return self.profile.drive(self.start, seconds)

    @property
    def poses(self) -> Array:
        """(T, 3) planar poses of the rig."""
        return self.path.poses(self.place(self.seconds))

    @property
    def outline(self) -> Array:
        """(T, 3) planar poses of the middle of the ego's outline, `EGO_LENGTH` x `EGO_WIDTH`."""
        poses = self.poses
        ahead = np.stack([np.cos(poses[:, 2]), np.sin(poses[:, 2]), np.zeros(len(poses))], axis=-1)
        return poses + CENTRE_OFFSET * ahead

    @property
    def mean_speed(self) -> float:
        """m/s over the log."""
        ends = self.place(self.seconds[[0, -1]])
        return float((ends[1] - ends[0]) / (self.seconds[-1] - self.seconds[0]))


def ego_drive(street: Street, seconds: Array, rng: np.random.Generator) -> EgoDrive:
    """The drive along `street.ego_route`, from `EGO_START` metres after its beginning.

    Args:
        seconds: (T,) times of poses.

    Raises:
        InputError: the street is too short for the drive.
    """
    path = RoutePath.along(street.map, extended_route(street.map, street.ego_route))
    profile = speed_profile(path, street.ego_speed, rng)
    first = street.map.lanes[street.ego_route[0]].centreline[0, :2]
    start = float(path.line.to_frenet(first)[0]) + EGO_START
    drive = EgoDrive(path, profile, start, seconds)
    end = float(drive.place(seconds[-1]))
    if end + _ROAD_AHEAD > path.length:
        problem = f"has {path.length:.0f} m, but {end + _ROAD_AHEAD:.0f} m are needed"
        raise InputError(street.kind, "ego_route", problem, "ask for fewer seconds")
    return drive


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
"""Seconds of driving, kept free before and behind a moving vehicle."""
_SAME_LANE = 1.8
_SEEN = (70.0, np.deg2rad(65), 0.3)
_CROSSING_DISTANCE, _CROSSING_ANGLE = 2.0, np.deg2rad(30)
_SPEED_SHARE = (0.8, 1.05)
_PARKED_WITHIN = 55.0
_TIGHT = 0.2
"""Metres that a parking spot must be longer than the car."""


@dataclass(frozen=True)
class TargetDrive:
    """How the target drives."""

    manner: Manner  # what was possible, see `Manner`
    path: RoutePath  # path of the target's middle
    place: Array  # (T,) metres along the path

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
    """A vehicle with its poses."""

    model: VehicleModel  # its shape
    poses: Array  # (T, 3) planar poses of its middle


@dataclass(frozen=True)
class TrafficScene:
    """What a new vehicle has to get on with."""

    street: Street  # lanes and parking
    ego: EgoDrive  # the ego's drive
    target: PlacedVehicle  # the vehicle not to hide

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
