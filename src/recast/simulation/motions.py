"""What the controlled actor does: the paper's motions.

A motion is scripted ahead of time from the situation at the start: the actor does not react to the
ego, so its states are the same for every planner and every renderer. Frenet coordinates are those
of the ego's reference route; gaps are from bumper to bumper. Their settings are in
`scenarios/*.yaml`. All have, besides what `ActorMotion` asks for, a `description` for people:
one sentence.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Protocol

import numpy as np
from numpy.typing import NDArray

from recast.dynamics import free_road_step
from recast.geometry import se2
from recast.planning import ReferenceRoute

Array = NDArray[np.float64]

DEFAULT_LANE_OFFSET = 3.5
"""Metres to the neighbouring lane where the map knows none."""


@dataclass(frozen=True)
class StartSituation:
    """Where everything is when a rollout starts.

    Attributes:
        route: the ego's reference route.
        ego_s: route coordinate of the ego's box centre, metres.
        ego_speed: m/s.
        ego_length: metres.
        actor_size: (3,) length, width, height of the actor's box, metres.
        neighbour_lateral: offset in metres, left positive, of the neighbouring lane of the same
            direction; None where there is none.
    """

    route: ReferenceRoute
    ego_s: float
    ego_speed: float
    ego_length: float
    actor_size: Array
    neighbour_lateral: float | None = None

    @property
    def reference_speed(self) -> float:
        """v_r: the ego's speed within [4, 12] m/s, which scales the moving motions."""
        return float(np.clip(self.ego_speed, 4.0, 12.0))

    @property
    def beside(self) -> float:
        """Lateral offset of a car in the next lane: the neighbour's, or 3.5 m to the left."""
        return DEFAULT_LANE_OFFSET if self.neighbour_lateral is None else self.neighbour_lateral

    def ahead(self, gap: float) -> float:
        """Route coordinate of the actor's centre, `gap` metres from the ego's front bumper."""
        return self.ego_s + gap + (self.ego_length + float(self.actor_size[0])) / 2


class ActorMotion(Protocol):
    """Scripts the actor. Implement this for a motion of your own.

    Attributes:
        name: for tables and file names, such as "cut-in".
        setting: which parameters, such as "a".
    """

    @property
    def name(self) -> str:
        """Name of the motion."""

    @property
    def setting(self) -> str:
        """Name of the setting."""

    def script(self, start: StartSituation, steps: int, dt: float) -> Array:
        """States (steps + 1, 4): x, y, heading of the box centre, speed >= 0; world, SI units."""


@dataclass(frozen=True)
class CutIn:
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
class Oncoming:
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
class Stationary:
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
class Advancing:
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


ScriptedMotion = CutIn | Oncoming | Stationary | Advancing
"""A motion of this package, which a scenario file can describe."""


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
