"""Logged traffic that stays in a rollout: as recorded, or giving way where something differs.

A vehicle that gives way stays on the path that the log saw it drive, and drives it later: of the
log it keeps the place, and an own clock tells how far it is. While nothing that is elsewhere than
in the log lies ahead, the clock runs with time, so that undisturbed traffic is the log, to the bit.
Else the Intelligent Driver Model (docs/scenarios.md#other-traffic) says how fast it may be.
"""

from __future__ import annotations

import math
import warnings
from collections.abc import Iterable, Mapping
from functools import cached_property
from typing import NamedTuple

import numpy as np
from numpy.typing import ArrayLike, NDArray

from recast.arrays import Array
from recast.dynamics import VehicleParameters, idm_acceleration
from recast.geometry import Polyline, boxes, se2
from recast.geometry.boxes import TOUCHING
from recast.logs.types import DrivingLog, Track, Trajectory
from recast.planning import ActorState
from recast.simulation.actor_motion import (
    EGO,
    BaseMotion,
    BaseScript,
    MotionInput,
    StartSituation,
)
from recast.simulation.motions import CORRIDOR_MARGIN, DRIVER, ahead_on_path, speeds_along
from recast.simulation.setup import TrafficKind

TRAFFIC = "traffic"
"""Name of the motions of traffic."""
_REACH = 100.0
"""Metres from the logged ego within which a track belongs to the traffic."""
_AHEAD = 80.0
"""Metres within which a driver looks at others."""
_END_US = 1_000_000
"""Time at each end of the labels over which the speed of the continuation is taken."""
_SHORTEST_US = 50_000
"""Time between two labels that tell a speed."""
_STANDING = 0.5
"""m/s; slower ends of labels are noise of a vehicle that stands."""
_MOVES = 1.0
"""Metres that the labels of a vehicle that moves span at least."""
_STEP = 0.25
"""Metres between two points of a path."""
_EXTENSION = 200.0
"""Metres by which a path goes straight on beyond its ends."""
ELSEWHERE = 0.5
"""Metres from its logged place at which a road user is taken to be elsewhere."""
_LATE_US = 50_000
"""Microseconds by which a vehicle that is behind its log meets others than it met there."""
_TOLD = 5
"""Pairs that a warning names."""
_SAMPLE_US = 500_000
"""Time between two looks at the boxes of the log."""


class LoggedWay:
    """Where a road user is at any time: as labelled, and straight on before and after.

    Args:
        path: `world_from_object` of the box centre.

    Attributes:
        moves: whether it is more than a vehicle that stands.
        first_us, last_us: time of the first and the last label.
    """

    def __init__(self, path: Trajectory) -> None:
        self._path, self._times = path, path.timestamps_us
        self._places: Array = path.poses[:, :2, 3]
        self.moves = bool(np.ptp(self._places, axis=0).max() > _MOVES)
        steps = np.linalg.norm(np.diff(self._places, axis=0), axis=1)
        self._driven = np.concatenate([[0.0], np.cumsum(steps)])
        self._ends = self._end_velocity(0), self._end_velocity(-1)
        self.first_us, self.last_us = int(self._times[0]), int(self._times[-1])
        self._placed = (self.first_us - 1, np.zeros(2))  # the last answer of `place`

    def _end_velocity(self, end: int) -> Array:
        """Velocity (2,) with which it comes and goes."""
        time = int(self._times[end])
        around = np.clip([time - _END_US, time + _END_US], *self._times[[0, -1]])
        if not self.moves or around[1] - around[0] < _SHORTEST_US:
            return np.zeros(2)
        before, after = self._path.at(around)[:, :2, 3]
        velocity: Array = (after - before) / ((around[1] - around[0]) * 1e-6)
        return velocity if np.linalg.norm(velocity) >= _STANDING else np.zeros(2)

    def in_space(self, times_us: ArrayLike) -> Array:
        """`world_from_object` (..., 4, 4) at times (...)."""
        times = np.asarray(times_us, np.int64)
        inside = np.clip(times, self._times[0], self._times[-1])
        poses = np.array(self._path.at(inside))
        beyond = (times - inside)[..., None] * 1e-6
        first, last = self._ends
        poses[..., :2, 3] += beyond * np.where(beyond < 0, first, last)
        return poses

    def poses(self, times_us: ArrayLike) -> Array:
        """x, y, heading (..., 3) at times (...)."""
        return np.asarray(se2.from_se3(self.in_space(times_us)))

    def place(self, time_us: int) -> Array:
        """x, y (2,) at a time; as quick as can be: all drivers ask for those of all others."""
        if self._placed[0] != time_us:
            inside = min(max(time_us, self.first_us), self.last_us)
            beyond = (time_us - inside) * 1e-6
            x, y = (np.interp(inside, self._times, self._places[:, axis]) for axis in (0, 1))
            place = np.array([x, y]) + beyond * self._ends[0 if beyond < 0 else 1]
            self._placed = time_us, place
        return self._placed[1]

    def __deepcopy__(self, memo: dict[int, object]) -> LoggedWay:
        return self  # it does not change

    def driven(self, time_us: int) -> float:
        """Metres driven from the first label to a time; negative before it."""
        inside = int(np.clip(time_us, self._times[0], self._times[-1]))
        beyond = (time_us - inside) * 1e-6
        speed = float(np.linalg.norm(self._ends[0 if beyond < 0 else 1]))
        return float(np.interp(inside, self._times, self._driven)) + beyond * speed

    def when(self, driven: float, latest_us: int) -> int:
        """The first time at which it has driven as far, at most `latest_us`."""
        low, high = 0.0, float(self._driven[-1])
        if driven < low or driven > high:
            end = 0 if driven < low else -1
            speed = float(np.linalg.norm(self._ends[end]))
            if speed == 0.0:
                return latest_us
            beyond = (driven - self._driven[end]) / speed
            return min(int(self._times[end]) + round(beyond * 1e6), latest_us)
        after = int(np.searchsorted(self._driven, driven, side="left"))
        if after == 0:
            return min(int(self._times[0]), latest_us)
        before, span = after - 1, self._driven[after] - self._driven[after - 1]
        share = (driven - self._driven[before]) / span
        step = int(self._times[after]) - int(self._times[before])
        return min(int(self._times[before]) + round(share * step), latest_us)

    def speed(self, time_us: int) -> float:
        """m/s at a time, over half a second to each side."""
        half = _END_US // 2
        return abs(self.driven(time_us + half) - self.driven(time_us - half)) / (2e-6 * half)

    @cached_property
    def line(self) -> Polyline | None:
        """The path, extended straight on at both ends; None for one that does not move."""
        if not self.moves:
            return None
        try:
            line = Polyline.from_points(self._places, _STEP)
        except ValueError:
            return None
        ends = line.position(np.array([-_EXTENSION, line.length + _EXTENSION]))
        return Polyline(np.concatenate([ends[:1], line.points, ends[1:]]))


class ReplayedTraffic(BaseScript):
    """Drives as logged, whatever the others do."""

    name, setting, follows_log = TRAFFIC, "replay", True

    def __init__(self, way: LoggedWay) -> None:
        self._way = way

    def in_space(self, times_us: NDArray[np.int64]) -> Array:
        """`world_from_actor` (..., 4, 4) at log times (...)."""
        return self._way.in_space(times_us)

    def script(self, start: StartSituation, steps: int, dt: float) -> Array:
        """States (steps + 1, 4) of `LoggedWay`."""
        step = round(dt * 1e6)
        times = start.start_timestamp_us + step * np.arange(steps + 1, dtype=np.int64)
        speeds = [self._way.speed(int(time)) for time in times]
        return np.column_stack([self._way.poses(times), speeds])


class YieldingTraffic(BaseMotion):
    """Drives its logged path, later than logged where something is in its way.

    Args:
        way: its own.
        ways: of all road users of the log by track id, and of the ego.
        together: ids of tracks whose boxes overlap its own in the log, such as that of a trailer:
            it does not give way to them.
    """

    name, setting, follows_log = TRAFFIC, "idm", True

    def __init__(
        self, way: LoggedWay, ways: Mapping[str, LoggedWay], together: frozenset[str]
    ) -> None:
        self._way, self._ways, self._together = way, ways, together
        self._clock, self._delayed, self._along = 0, False, 0.0
        self._pose: Array = np.eye(4)

    def start(self, situation: StartSituation) -> Array:
        """The logged state (4,)."""
        self._clock, self._delayed = situation.start_timestamp_us, False
        state = self._state(self._way.speed(self._clock))
        if self._way.line is not None:
            self._along = float(self._way.line.to_frenet(state[:2])[0])
        return state

    def _state(self, speed: float) -> Array:
        """The state (4,) at the clock."""
        self._pose = self._way.in_space(self._clock)
        return np.append(se2.from_se3(self._pose), speed)

    def in_space(self) -> Array:
        """`world_from_actor` (4, 4) of the state that was given last."""
        return self._pose

    def step(self, state: MotionInput, dt: float) -> Array:
        """The state (4,) of the log at a clock that stands still while it has to wait."""
        way, step = self._way, round(dt * 1e6)
        now = state.situation.start_timestamp_us + state.step * step
        wanted = way.driven(self._clock + step) - way.driven(self._clock)
        speed, limit = float(state.state[3]), np.inf
        if way.line is not None:
            limit = speed + self._acceleration(state, now, speed) * dt
            if self._delayed:
                limit = min(limit, speed + DRIVER.max_acceleration * dt)
        if limit * dt >= wanted:
            self._clock += step
            speed = way.speed(self._clock)
        else:
            self._delayed, speed = True, max(float(limit), 0.0)
            reached = way.driven(self._clock) + speed * dt
            self._clock = max(way.when(reached, self._clock + step), self._clock)
        return self._state(speed)

    def _acceleration(self, state: MotionInput, now: int, speed: float) -> float:
        """What the model allows behind those who matter, m/s^2; inf if nobody does."""
        line, here = self._way.line, state.state[:2]
        assert line is not None
        self._along = float(line.to_frenet(here, self._along)[0])
        everyone = state.shared
        away = np.linalg.norm(everyone.points[:, 0] - here, axis=1)
        own = state.situation.track_id
        met = [
            k
            for k in np.flatnonzero(away <= _AHEAD)
            if everyone.users[k].track_id != own and self._matters(everyone.users[k], now)
        ]
        if not met:
            return np.inf
        length, width = state.situation.actor_size[:2]
        along, lateral = line.to_frenet(everyone.points[met])
        speeds = speeds_along(everyone.velocities[met], line.heading(along[:, 0]))
        # Who comes towards it may pass closely: else two would block each other for ever.
        half = width / 2 + np.where(speeds < 0.0, 0.0, CORRIDOR_MARGIN)
        ahead = ahead_on_path(along, lateral[:, 1:], self._along, half)
        if not ahead.any():
            return np.inf
        gaps = along[ahead, 1:].min(axis=1) - self._along - length / 2
        target = max(self._way.speed(self._clock), speed, 1.0)
        return float(idm_acceleration(speed, target, gaps, speeds[ahead], DRIVER).min())

    def _matters(self, user: ActorState, now: int) -> bool:
        """Whether a road user may be met that was not met in the log."""
        if user.track_id in self._together:
            return False
        way = self._ways.get(user.track_id)
        if way is None:
            return True
        elsewhere = math.dist(user.pose[:2], way.place(now)) > ELSEWHERE
        return bool(elsewhere or (way.moves and now - self._clock > _LATE_US))


class Member(NamedTuple):
    """A track of the traffic, what it does, and the tracks that overlap it in the log."""

    track: Track
    motion: ReplayedTraffic | YieldingTraffic
    together: frozenset[str]


def traffic_of(
    log: DrivingLog,
    kind: TrafficKind,
    controlled: Iterable[str],
    times_us: NDArray[np.int64],
    vehicle: VehicleParameters,
) -> list[Member]:
    """The traffic of a rollout in the order of the log's tracks.

    It has all tracks but the controlled ones that come within 100 m of the logged ego, and that
    are labelled during the rollout, or stand there later. Warns of boxes that overlap in the log,
    since they do not give way to each other.

    Args:
        controlled: ids of tracks that move otherwise.
        times_us: (S+1,) log times of the rollout's states.
        vehicle: the ego.
    """
    if kind == "none":
        return []
    start_us, times = int(times_us[0]), np.arange(times_us[0], times_us[-1] + 1, _SAMPLE_US)
    rig = log.world_from_rig
    centre = se2.to_se3(np.array([vehicle.centre_offset, 0.0, 0.0]))
    ego = LoggedWay(Trajectory(rig.timestamps_us, rig.poses @ centre))
    ways = {key: LoggedWay(track.trajectory) for key, track in log.tracks.items()}
    there = ego.poses(times)[:, :2]
    fixed = set(controlled)
    chosen = [
        key
        for key, way in ways.items()
        if key not in fixed
        and way.last_us >= start_us
        and (way.first_us <= times_us[-1] or not way.moves)
        and np.linalg.norm(way.poses(times)[:, :2] - there, axis=1).min() <= _REACH
    ]
    together = _together({key: log.tracks[key] for key in (*chosen, *sorted(fixed))}, times)
    everyone = {**ways, EGO: ego}

    def motion(key: str) -> ReplayedTraffic | YieldingTraffic:
        if kind == "replay":
            return ReplayedTraffic(ways[key])
        return YieldingTraffic(ways[key], everyone, together[key])

    if kind == "idm":
        _warn_of(together, chosen)
    return [Member(log.tracks[key], motion(key), together[key]) for key in chosen]


def _together(tracks: Mapping[str, Track], times: NDArray[np.int64]) -> dict[str, frozenset[str]]:
    """Of each track those whose boxes overlap its own in the log at one of some times."""
    found: dict[str, set[str]] = {key: set() for key in tracks}
    keys, reach = list(tracks), [np.hypot(*one.size[:2]) / 2 for one in tracks.values()]
    places = np.full((len(keys), len(times), 2), np.nan)
    for row, track in zip(places, tracks.values(), strict=True):
        first, last = track.trajectory.timestamps_us[[0, -1]]
        there = (times >= first) & (times <= last)
        row[there] = track.trajectory.at(times[there])[:, :2, 3]
    for k, (one, rest) in enumerate(zip(keys, places, strict=True)):
        apart = np.linalg.norm(places[k + 1 :] - rest, axis=2)
        near = apart <= reach[k] + np.array(reach[k + 1 :])[:, None]  # never where NaN
        for index in np.flatnonzero(near.any(axis=1)):
            other, both = keys[k + 1 + index], times[near[index]]
            a, b = tracks[one], tracks[other]
            poses = [se2.from_se3(track.trajectory.at(both)) for track in (a, b)]
            if boxes.bev_overlap_area(poses[0], a.size, poses[1], b.size).max() > TOUCHING:
                found[one].add(other)
                found[other].add(one)
    return {key: frozenset(of) for key, of in found.items()}


def _warn_of(together: Mapping[str, frozenset[str]], chosen: Iterable[str]) -> None:
    pairs = sorted({tuple(sorted((one, other))) for one in chosen for other in together[one]})
    if pairs:
        named = ", ".join(f"{one} and {other}" for one, other in pairs[:_TOLD])
        if len(pairs) > _TOLD:
            named += f", and {len(pairs) - _TOLD} more"
        text = f"boxes of traffic overlap in the log, and do not give way to each other: {named}"
        warnings.warn(text, RuntimeWarning, stacklevel=2)
