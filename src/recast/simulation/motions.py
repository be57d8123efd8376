"""What the controlled actor does: the paper's motions, and what the log saw it do.

These motions are scripted from the situation at the start. The actor does not react to the ego, so
its states are the same for every planner and every renderer. Frenet coordinates are those of the
ego's reference route; gaps are from bumper to bumper. Their settings are in `scenarios/*.yaml`.
All have, besides what `ActorMotion` asks for, a `description` for people: one sentence.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from recast.arrays import Array
from recast.dynamics import free_road_step
from recast.geometry import se2
from recast.logs.motion import logged_velocity
from recast.simulation.actor_motion import Scripted, StartSituation


@dataclass(frozen=True)
class CutIn(Scripted):
    """Drives beside and ahead of the ego, then moves into its lane while slowing down.

    Attributes:
        gap: metres at the start.
        initial_speed, target_speed: as shares of the reference speed v_r.
        delay, duration: seconds until the lane change begins, and it takes.
        stop_after: seconds from the end of the lane change until it brakes to a standstill. None:
            it drives on. The name should say which, as results show it.
    """

    setting: str
    gap: float
    initial_speed: float
    target_speed: float
    delay: float
    duration: float
    stop_after: float | None = None
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
        u = np.clip((dt * np.arange(steps + 1) - self.delay) / self.duration, 0.0, 1.0)
        lateral = start.beside * (1 - u**3 * (10 - 15 * u + 6 * u**2))
        across = -start.beside * u**2 * (30 - 60 * u + 30 * u**2) / self.duration
        poses = start.route.pose(s, lateral)
        poses[:, 2] += np.arctan2(across, np.maximum(along, 0.5))
        return _states(poses, np.hypot(along, across))


@dataclass(frozen=True)
class Oncoming(Scripted):
    """Comes towards the ego in its lane.

    Attributes:
        gap: metres at the start.
        speed: m/s.
        stop_distance: metres after which it stands: an ego that brakes avoids it. None: it drives
            on, and hits an ego that stands. The name should say which, as results show it.
        lateral: metres to the left of the route.
    """

    setting: str
    gap: float
    speed: float
    stop_distance: float | None = None
    lateral: float = 0.0
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
class Stationary(Scripted):
    """Stands in the ego's lane, facing it.

    The gap is the larger of `min_gap` and what the ego needs to stop, v^2 / `braking` + `reserve`.

    Attributes:
        min_gap: metres.
        braking: twice the deceleration that just suffices, m/s^2.
        reserve: metres.
        yaw: radians off the direct facing.
        lateral: metres to the left of the route.
    """

    setting: str
    min_gap: float
    braking: float
    reserve: float
    yaw: float = 0.0
    lateral: float = 0.0
    name: str = "stationary"
    description: str = ""

    def script(self, start: StartSituation, steps: int, dt: float) -> Array:
        """One pose for all steps."""
        gap = max(self.min_gap, start.ego_speed**2 / self.braking + self.reserve)
        pose = start.route.pose(start.ahead(gap), self.lateral)
        pose[2] += np.pi + self.yaw
        return _states(np.tile(pose, (steps + 1, 1)), np.zeros(steps + 1))


@dataclass(frozen=True)
class Advancing(Scripted):
    """Drives slowly in the next lane, so that the ego passes it.

    Attributes:
        gap: metres at the start.
        speed: as a share of the reference speed v_r.
    """

    setting: str
    gap: float
    speed: float
    name: str = "advancing"
    description: str = ""

    def script(self, start: StartSituation, steps: int, dt: float) -> Array:
        """Along the route at constant speed and offset."""
        target = self.speed * start.reference_speed
        s, speed = _drive(start.ahead(self.gap), target, target, steps, dt)
        return _states(start.route.pose(s, start.beside), speed)


@dataclass(frozen=True)
class LogReplay(Scripted):
    """Drives as logged; after its last label it keeps speed and heading."""

    setting: str = "a"
    name: str = "log-replay"
    description: str = ""

    @property
    def follows_log(self) -> bool:
        """True: the actor was recorded wherever it is."""
        return True

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


def _states(poses: Array, speed: Array) -> Array:
    poses[:, 2] = se2.wrap_angle(poses[:, 2])
    return np.concatenate([poses, speed[:, None]], axis=1)
