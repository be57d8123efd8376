"""Drives along lanes: the route, the smooth path on it, its speed, and the ego."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from functools import cached_property
from typing import Literal

import numpy as np
from numpy.typing import ArrayLike
from scipy.interpolate import CubicSpline
from scipy.ndimage import gaussian_filter1d

from recast.arrays import Array
from recast.core.errors import InputError
from recast.geometry import Polyline, se2
from recast.logs import HdMap
from recast.synthetic.streets import EGO_START
from recast.synthetic.world import Street

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
    """A path with continuous heading and curvature.

    Attributes:
        lanes: the lanes it follows, in order.
        line: its points, 0.5 m apart.
    """

    lanes: tuple[str, ...]
    line: Polyline

    @classmethod
    def along(cls, street_map: HdMap, lanes: Sequence[str]) -> RoutePath:
        """The rounded centreline of successive lanes.

        Raises:
            ValueError: the lanes hold fewer than two distinct points.
        """
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
    """Speed by place.

    Attributes:
        s: (N,) metres along the path, evenly spaced from 0.
        speed: (N,) m/s, positive.
    """

    s: Array
    speed: Array

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
    """A drive of the rear axle along a path.

    Attributes:
        path: the route's centreline, with all the road before and after.
        profile: speed by place on it.
        start: metres along the path at time 0.
        seconds: (T,) times of the log's poses.
    """

    path: RoutePath
    profile: SpeedProfile
    start: float
    seconds: Array

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
