"""What a controlled actor does: the paper's motions, what the log saw it do, and one that reacts.

All but `Idm` are scripted from the situation at the start: the actor does not react to the ego, so
its states are the same for every planner and every renderer. Frenet coordinates are those of the
ego's reference route; gaps are from bumper to bumper. Their settings are in `scenarios/*.yaml`.
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from itertools import pairwise
from typing import Annotated

import numpy as np
from numpy.typing import ArrayLike, NDArray

from recast.arrays import Array
from recast.dynamics import IdmParameters, free_road_step, idm_acceleration
from recast.geometry import se2
from recast.logs.checks import WORLD_REACH
from recast.logs.motion import logged_velocity
from recast.planning import ReferenceRoute
from recast.simulation.actor_motion import (
    BaseMotion,
    BaseScript,
    MotionInput,
    Quantity,
    Rows,
    StartSituation,
)

_Gap = Annotated[float, Quantity("m", -50.0, 500.0)]
"""Less than 0: beside or behind the ego."""
_Share = Annotated[float, Quantity("of v_r", 0.0, 5.0)]
_Lateral = Annotated[float, Quantity("m", -20.0, 20.0)]
_Seconds = Annotated[float, Quantity("s", 0.0, 60.0)]
_PLACE = Quantity("m", -WORLD_REACH, WORLD_REACH)
_PATH = Rows(
    Quantity("s", -1000.0, 1000.0), _PLACE, _PLACE, Quantity("rad", -10.0, 10.0), least=2
)  # fmt: skip
_TURN = 1.3
"""Seconds in which somebody turns round."""
_WALKING = 3.0
"""m/s^2 with which people gain and lose speed."""
_SUBSTEPS = 10
DRIVER = IdmParameters(max_acceleration=1.5, max_deceleration=2.5, emergency_deceleration=8.0)
"""Accelerations of the driver; gap and headway are the motion's."""
CORRIDOR_MARGIN = 0.3
"""Metres on each side of the actor's width within which a road user is on its path."""


@dataclass(frozen=True)
class CutIn(BaseScript):
    """Drives beside and ahead of the ego, then moves into its lane while slowing down.

    Attributes:
        gap: metres from the ego's front bumper to the actor at the start.
        initial_speed: speed at the start, as a share of the reference speed v_r.
        target_speed: speed that it changes to, as a share of v_r.
        delay: seconds until the lane change begins.
        duration: seconds that the lane change takes.
        stop_after: seconds from the end of the lane change until it brakes to a standstill. None:
            it drives on. The name should say which, as results show it.
    """

    setting: str
    gap: _Gap
    initial_speed: _Share
    target_speed: _Share
    delay: _Seconds
    duration: Annotated[float, Quantity("s", 0.0, 60.0, positive=True)]
    stop_after: Annotated[float | None, Quantity("s", 0.0, 60.0)] = None
    name: str = "cut-in"
    description: str = ""

    def script(self, start: StartSituation, steps: int, dt: float) -> Array:
        """Lateral offset l0 (1 - q(u)), q the quintic from 0 to 1, u = (t - delay) / duration."""
        halt = np.inf
        if self.stop_after is not None:
            halt = self.delay + self.duration + self.stop_after
        s, along = _drive(
            start.ahead(self.gap),
            self.initial_speed * start.reference_speed,
            self.target_speed * start.reference_speed,
            steps,
            dt,
            halt=halt,
        )
        now: Array = dt * np.arange(steps + 1, dtype=np.float64)
        share, across = _moving_over(now, self.delay, self.duration, -start.beside)
        lateral = start.beside * (1 - share)
        poses = start.route.pose(s, lateral)
        poses[:, 2] += np.arctan2(across, np.maximum(along, 0.5))
        return _states(poses, np.hypot(along, across))


@dataclass(frozen=True)
class Oncoming(BaseScript):
    """Comes towards the ego in its lane.

    Attributes:
        gap: metres from the ego's front bumper to the actor at the start.
        speed: speed of the actor, m/s.
        stop_distance: metres after which it stands: an ego that brakes avoids it. None: it drives
            on, and hits an ego that stands. The name should say which, as results show it.
        lateral: offset from the route in metres, left positive.
    """

    setting: str
    gap: _Gap
    speed: Annotated[float, Quantity("m/s", 0.0, 100.0)]
    stop_distance: Annotated[float | None, Quantity("m", 0.0, 1000.0, positive=True)] = None
    lateral: _Lateral = 0.0
    name: str = "oncoming"
    description: str = ""

    def script(self, start: StartSituation, steps: int, dt: float) -> Array:
        """Against the route at constant speed, then braking to the stop point."""
        stop = np.inf if self.stop_distance is None else self.stop_distance
        driven, speed = _drive(0.0, self.speed, self.speed, steps, dt, stop)
        poses = start.route.pose(start.ahead(self.gap) - driven, self.lateral)
        poses[:, 2] += np.pi
        return _states(poses, speed)


@dataclass(frozen=True)
class Stationary(BaseScript):
    """Stands in the ego's lane, facing it.

    The gap is the larger of `min_gap` and what the ego needs to stop, v^2 / `braking` + `reserve`.

    Attributes:
        min_gap: smallest gap, metres.
        braking: twice the deceleration that just suffices, m/s^2.
        reserve: distance added to v^2 / `braking`, metres.
        yaw: angle off the direct facing, radians.
        lateral: offset from the route in metres, left positive.
    """

    setting: str
    min_gap: _Gap
    braking: Annotated[float, Quantity("m/s^2", 0.0, 20.0, positive=True)]
    reserve: Annotated[float, Quantity("m", 0.0, 500.0)]
    yaw: Annotated[float, Quantity("rad", -np.pi, np.pi)] = 0.0
    lateral: _Lateral = 0.0
    name: str = "stationary"
    description: str = ""

    def script(self, start: StartSituation, steps: int, dt: float) -> Array:
        """One pose for all steps."""
        gap = max(self.min_gap, start.ego_speed**2 / self.braking + self.reserve)
        pose = start.route.pose(start.ahead(gap), self.lateral)
        pose[2] += np.pi + self.yaw
        return _states(np.tile(pose, (steps + 1, 1)), np.zeros(steps + 1))


@dataclass(frozen=True)
class Advancing(BaseScript):
    """Drives slowly in the next lane, so that the ego passes it.

    Attributes:
        gap: metres from the ego's front bumper to the actor at the start.
        speed: speed as a share of the reference speed v_r.
    """

    setting: str
    gap: _Gap
    speed: _Share
    name: str = "advancing"
    description: str = ""

    def script(self, start: StartSituation, steps: int, dt: float) -> Array:
        """Along the route at constant speed and offset."""
        target = self.speed * start.reference_speed
        s, speed = _drive(start.ahead(self.gap), target, target, steps, dt)
        return _states(start.route.pose(s, start.beside), speed)


@dataclass(frozen=True)
class RouteCrossing(BaseScript):
    """Crosses the ego's route at right angles, as people on foot and on bicycles do.

    It gains and loses speed with 3 m/s^2, and turns round within 1.3 s.

    Attributes:
        gap: metres from the ego's front bumper at the start to the actor's nearer side.
        speed: speed while it moves, m/s.
        begin: offset from the route at which it begins, metres, left positive; it crosses towards
            the other side.
        delay: seconds until it begins.
        pause_at: offset at which it stops; None: it does not.
        pause: seconds for which it stops there; None: for good.
        turn_at: offset at which it turns round and goes back to where it began; None: it does not.

    Raises:
        ValueError: it begins on the route, or stops or turns where it does not come.
    """

    setting: str
    gap: _Gap
    speed: Annotated[float, Quantity("m/s", 0.0, 20.0, positive=True)]
    begin: Annotated[float, Quantity("m", -50.0, 50.0)]
    delay: _Seconds = 0.0
    pause_at: Annotated[float | None, Quantity("m", -50.0, 50.0)] = None
    pause: Annotated[float | None, Quantity("s", 0.0, 60.0)] = None
    turn_at: Annotated[float | None, Quantity("m", -50.0, 50.0)] = None
    name: str = "crossing"
    description: str = ""

    def __post_init__(self) -> None:
        if self.begin == 0.0:
            raise ValueError("begin: is 0, on the route; give an offset to the left or the right")
        for name in ("pause_at", "turn_at"):
            at = getattr(self, name)
            if at is not None and self._way(at) < 0.0:
                raise ValueError(f"{name}: is {at:g}, behind where it begins; give another offset")
        turn = np.inf if self.turn_at is None else self._way(self.turn_at)
        if self.pause_at is not None and self._way(self.pause_at) > turn:
            raise ValueError("pause_at: lies beyond turn_at; give an offset before that")
        if self.pause is not None and self.pause_at is None:
            raise ValueError("pause: is the time at pause_at; give pause_at as well")

    def _way(self, offset: float) -> float:
        """Metres from where it begins to an offset, in the direction in which it crosses."""
        return (self.begin - offset) * float(np.sign(self.begin))

    def script(self, start: StartSituation, steps: int, dt: float) -> Array:
        """Straight across; without a delay it moves from the start on."""
        across, turned, speed = self._walk(steps, dt)
        side = float(np.sign(self.begin))
        s = start.ego_s + start.ego_length / 2 + self.gap + float(start.actor_size[1]) / 2
        poses = start.route.pose(np.full(steps + 1, s), self.begin - side * across)
        poses[:, 2] += side * np.pi * (turned - 0.5)
        return _states(poses, speed)

    def _walk(self, steps: int, dt: float) -> tuple[Array, Array, Array]:
        """Metres across, how far it has turned round in [0, 1], and speed, (steps + 1,) each."""
        pause = np.inf if self.pause is None else self.pause
        stops: list[tuple[float, float, bool]] = []  # metres across, seconds, turns round there
        if self.pause_at is not None:
            stops.append((self._way(self.pause_at), pause, False))
        if self.turn_at is not None:
            stops.append((self._way(self.turn_at), _TURN, True))
            stops.append((0.0, np.inf, False))
        fine = dt / _SUBSTEPS
        across, turned, wait, turning = 0.0, 0.0, self.delay, False
        speed, direction = self.speed if self.delay == 0.0 else 0.0, 1.0
        if stops:
            speed = min(speed, float(np.sqrt(2.0 * _WALKING * stops[0][0])))
        found = np.empty((steps + 1, 3))
        for k in range(steps * _SUBSTEPS + 1):
            if k % _SUBSTEPS == 0:
                found[k // _SUBSTEPS] = across, turned, speed
            if wait > 1e-9:
                wait -= fine
                if turning:
                    turned = min(turned + fine / _TURN, 1.0)
                continue
            turning, left = False, np.inf
            if stops:
                left = max((stops[0][0] - across) * direction, 0.0)
            braking = np.sqrt(2.0 * _WALKING * left)
            speed = float(min(self.speed, speed + _WALKING * fine, braking))
            across += direction * min(speed * fine, left)
            if stops and left <= speed * fine:
                (across, wait, turning), speed = stops.pop(0), 0.0
                direction = -direction if turning else direction
        return found[:, 0], found[:, 1], found[:, 2]


@dataclass(frozen=True)
class Along(BaseScript):
    """Walks or rides along the ego's route, and may move over.

    Attributes:
        gap: metres from the ego's front bumper at the start to the actor.
        speed: speed along the route, m/s.
        lateral: offset from the route at the start, metres, left positive.
        to: offset to which it moves; None: it stays at its offset.
        delay: seconds until it begins to move over.
        duration: seconds that this takes.
    """

    setting: str
    gap: _Gap
    speed: Annotated[float, Quantity("m/s", 0.0, 50.0)]
    lateral: _Lateral
    to: Annotated[float | None, Quantity("m", -20.0, 20.0)] = None
    delay: _Seconds = 0.0
    duration: Annotated[float, Quantity("s", 0.0, 60.0, positive=True)] = 2.0
    name: str = "along"
    description: str = ""

    def script(self, start: StartSituation, steps: int, dt: float) -> Array:
        """The offset changes by the quintic of `CutIn`."""
        now: Array = dt * np.arange(steps + 1, dtype=np.float64)
        change = 0.0 if self.to is None else self.to - self.lateral
        share, across = _moving_over(now, self.delay, self.duration, change)
        lateral = self.lateral + change * share
        poses = start.route.pose(start.ahead(self.gap) + self.speed * now, lateral)
        poses[:, 2] += np.arctan2(across, max(self.speed, 0.5))
        return _states(poses, np.hypot(self.speed, across))


@dataclass(frozen=True)
class LoggedMotion(BaseScript):
    """Drives as logged; after its last label it keeps speed and heading."""

    follows_log = True
    setting: str = "a"
    name: str = "log-replay"
    description: str = ""

    def script(self, start: StartSituation, steps: int, dt: float) -> Array:
        """Logged poses (steps + 1, 4); speeds are differences over one step to each side.

        Raises:
            InputError: the log does not have the actor at the start.
        """
        track = start.labelled()
        step_us = round(dt * 1e6)
        times = start.start_timestamp_us + step_us * np.arange(steps + 1, dtype=np.int64)
        last = int(track.timestamps_us[-1])
        logged = np.minimum(times, last)
        poses = se2.from_se3(track.at(logged))
        velocity = logged_velocity(track, logged, step_us)
        late = times > last
        poses[late, :2] += velocity[late] * ((times - logged)[late] * 1e-6)[:, None]
        poses[:, 2] = se2.wrap_angle(poses[:, 2])
        return np.concatenate([poses, np.linalg.norm(velocity, axis=1)[:, None]], axis=1)


@dataclass(frozen=True)
class TimedPath(BaseScript):
    """Is at given places at given times, whatever the road and the ego do.

    Positions and headings are linear between two rows. Before the first row and after the last one
    the velocity stays and the heading too.

    Attributes:
        path: rows of seconds after the start of the rollout, x, y and heading of the box centre in
            the world of the log.
        start_after: seconds after the log's first ego pose at which a rollout with this target
            starts; None for the usual start.

    Raises:
        ValueError: the times do not increase.
    """

    setting: str
    path: Annotated[tuple[tuple[float, float, float, float], ...], _PATH]
    start_after: Annotated[float | None, Quantity("s", 0.0, 100_000.0)] = None
    name: str = "timed-path"
    description: str = ""

    def __post_init__(self) -> None:
        times = [row[0] for row in self.path]
        if any(later <= earlier for earlier, later in pairwise(times)):
            raise ValueError("path: its times do not increase; give each row a later time")

    def script(self, start: StartSituation, steps: int, dt: float) -> Array:
        """States (steps + 1, 4); the speed is that of the row before, or of the first two rows."""
        rows = np.array(self.path, np.float64)
        times, places = rows[:, 0], rows[:, 1:3]
        velocity = np.diff(places, axis=0) / np.diff(times)[:, None]
        now = dt * np.arange(steps + 1)
        segment = np.clip(np.searchsorted(times, now, "right") - 1, 0, len(velocity) - 1)
        since = (now - times[segment])[:, None]
        xy = places[segment] + velocity[segment] * since
        heading = np.interp(now, times, np.unwrap(rows[:, 3]))
        speed = np.linalg.norm(velocity[segment], axis=1)
        return np.concatenate([xy, se2.wrap_angle(heading)[:, None], speed[:, None]], axis=1)


def _moving_over(now: Array, delay: float, duration: float, change: float) -> tuple[Array, Array]:
    """Share (T,) of a change of the offset that is done at seconds `now` (T,), by the quintic from
    0 to 1, and the speed across (T,)."""
    u = np.clip((now - delay) / duration, 0.0, 1.0)
    share = u**3 * (10 - 15 * u + 6 * u**2)
    return share, change * u**2 * (30 - 60 * u + 30 * u**2) / duration


def ahead_on_path(along: Array, offset: Array, s: float, half: ArrayLike) -> NDArray[np.bool_]:
    """Which (U,) of the road users are ahead of an actor and in its way.

    Args:
        along: (U, 9) path coordinates of `RoadUsers.points`.
        offset: (U, 8) metres beside the path, of all points but the centres.
        s: path coordinate of the actor's centre.
        half: metres to each side, one number or (U,), within which they are in the way.
    """
    inside = (offset.min(axis=1) <= half) & (offset.max(axis=1) >= -np.asarray(half))
    return inside & (along[:, 0] > s)


def speeds_along(velocities: Array, heading: Array) -> Array:
    """m/s (U,) of velocities (U, 2) in the direction of a path there."""
    direction = np.stack([np.cos(heading), np.sin(heading)], axis=-1)
    return np.asarray(np.sum(velocities * direction, axis=1))


def _faced(pose: Array, heading: float) -> Array:
    """A pose (3,) of a path, turned around for a vehicle that goes there backwards."""
    backwards = abs(float(se2.wrap_angle(pose[2] - heading))) > np.pi / 2
    return pose + np.array([0.0, 0.0, np.pi * backwards])


def _drive(
    s: float,
    speed: float,
    target: float,
    steps: int,
    dt: float,
    stop: float = np.inf,
    halt: float = np.inf,
) -> tuple[Array, Array]:
    """Route coordinate and speed (steps + 1,) of free-road driving.

    Args:
        stop: route coordinate at which it stands.
        halt: seconds after which it brakes to a standstill.
    """
    states = np.empty((steps + 1, 2))
    states[0] = s, speed
    for k in range(steps):
        wanted = target if k * dt < halt - 1e-9 else 0.0
        states[k + 1] = free_road_step(states[k], wanted, stop, dt=dt)
    return states[:, 0], states[:, 1]


def _states(poses: Array, speed: ArrayLike) -> Array:
    """States (..., 4) of poses (..., 3) and speeds (...)."""
    heading, speeds = se2.wrap_angle(poses[..., 2]), np.asarray(speed)
    return np.stack([poses[..., 0], poses[..., 1], heading, speeds], axis=-1)


@dataclass(frozen=True)
class Idm(BaseMotion):
    """Follows a path at a desired speed and keeps its distance from whoever is ahead on it.

    The path is the actor's own logged one, at whose place at the start it begins with its logged
    speed. If `gap` is given, it is the ego's route: the actor begins `gap` metres ahead of the ego
    at the desired speed. The speed follows the intelligent driver model behind the nearest road
    user whose box is within the actor's width and 0.3 m on each side: ego, controlled and logged
    actors. Nothing is predicted: a vehicle that crosses the path is seen once it is on it.

    Attributes:
        speed: desired speed, as a share of the reference speed v_r.
        headway: time behind the road user ahead, seconds.
        min_gap: metres to the road user ahead at a standstill, bumper to bumper.
        gap: metres ahead of the ego at the start; None for the actor's own path.
        lateral: offset from the ego's route in metres, left positive; needs `gap`.

    Raises:
        ValueError: `lateral` is given without `gap`, or a parameter is out of range.
    """

    setting: str
    speed: Annotated[float, Quantity("of v_r", 0.0, 5.0, positive=True)] = 1.0
    headway: _Seconds = 1.5
    min_gap: Annotated[float, Quantity("m", 0.0, 100.0, positive=True)] = 2.0
    gap: Annotated[float | None, Quantity("m", -50.0, 500.0)] = None
    lateral: _Lateral = 0.0
    name: str = "idm"
    description: str = ""

    def __post_init__(self) -> None:
        if self.gap is None and self.lateral != 0.0:
            raise ValueError("lateral: is an offset from the ego's route; give gap as well")
        for name, least in (("speed", 0.0), ("min_gap", 0.0)):
            if not getattr(self, name) > least:
                raise ValueError(f"{name}: is {getattr(self, name)}; give more than 0")
        if not self.headway >= 0.0:
            raise ValueError(f"headway: is {self.headway}; give 0 or more")

    @property
    def follows_log(self) -> bool:  # type: ignore[override]
        """Whether the path is the actor's own."""
        return self.gap is None

    def start(self, situation: StartSituation) -> Array:
        """The state (4,) at the start, on the path.

        Raises:
            InputError: the path is the actor's own, and it is not labelled at the start.
        """
        if self.gap is not None:
            pose = situation.route.pose(situation.ahead(self.gap), self.lateral)
            return _states(pose, self.speed * situation.reference_speed)
        track, now = situation.labelled(), situation.start_timestamp_us
        path, pose = situation.own_path, se2.from_se3(track.at(now))
        s, _ = path.project(pose, path.at_time(now))
        speed = float(np.linalg.norm(logged_velocity(track, now, 100_000)))
        return _states(_faced(path.pose(s), pose[2]), speed)

    def step(self, state: MotionInput, dt: float) -> Array:
        """One forward Euler step (4,) of the model, as in `recast.dynamics.idm_step`."""
        path, speed = self._path(state.situation), float(state.state[3])
        s = float(path.project(state.state, self._near(state, path))[0])
        gaps, speeds = self._leads(state, path, s)
        target = self.speed * state.situation.reference_speed
        parameters = replace(DRIVER, headway=self.headway, min_gap=self.min_gap)
        acceleration = float(idm_acceleration(speed, target, gaps, speeds, parameters).min())
        faster = max(speed + acceleration * dt, 0.0)
        if speed == 0.0:  # projecting back and forth would let a standing car creep
            return np.append(state.state[:3], faster)
        pose = path.pose(s + speed * dt, self.lateral)
        return _states(_faced(pose, state.state[2]), faster)

    def _near(self, state: MotionInput, path: ReferenceRoute) -> float | None:
        """Where the actor is on its path by the way that it has gone."""
        start = state.situation.start_timestamp_us
        begin = path.at_time(start) if self.gap is None else state.situation.ahead(self.gap)
        known = begin is not None and state.travelled is not None
        return float(begin) + state.travelled if known else None  # type: ignore[arg-type, operator]

    def _path(self, situation: StartSituation) -> ReferenceRoute:
        return situation.own_path if self.gap is None else situation.route

    def _leads(self, state: MotionInput, path: ReferenceRoute, s: float) -> tuple[Array, Array]:
        """Gaps (L,) in metres, bumper to bumper, and speeds (L,) along the path of all who are
        ahead on it; the last one is nobody, infinitely far."""
        length, width = state.situation.actor_size[:2]
        half = width / 2 + CORRIDOR_MARGIN
        users = state.shared
        along, lateral = path.project(users.points)
        ahead = ahead_on_path(along, lateral[:, 1:] - self.lateral, s, half)
        ahead &= users.ids != state.situation.track_id
        gaps = along[ahead, 1:].min(axis=1) - s - length / 2
        speeds = speeds_along(users.velocities[ahead], path.heading(along[ahead, 0]))
        return np.append(gaps, np.inf), np.append(speeds, 0.0)
