"""Simple planners: straight ahead, the log's own drive, and probes to prove frame conventions.

The motion of probes is known in advance. Each can be named, as
`recast.planning.simple:left_arc`. `recast.simulation.probe_path` drives any planner over an empty
plane and says where it went.
"""

from __future__ import annotations

from collections.abc import Mapping
from functools import partial

import numpy as np
from numpy.typing import ArrayLike, NDArray

from recast.dynamics import initial_state
from recast.dynamics import state as ego
from recast.geometry import se2
from recast.planning.types import (
    WAYPOINTS,
    BasePlanner,
    Plan,
    PlannerInput,
    PlanningContext,
)


class _Blind(BasePlanner):
    """Knows the times of its waypoints, and sees nothing."""

    needs_images = False

    def __init__(self) -> None:
        self._times = 0.1 * np.arange(1, WAYPOINTS + 1)

    def reset(self, context: PlanningContext) -> None:
        """Take the time step."""
        self._times = context.dt * np.arange(1, WAYPOINTS + 1)


class ConstantVelocity(_Blind):
    """Keeps heading and speed; sees nothing."""

    name = "constant-velocity"

    def plan(self, observation: PlannerInput) -> Plan:
        """Waypoints on the ego's x axis."""
        waypoints = np.zeros((WAYPOINTS, 3))
        waypoints[:, 0] = max(float(observation.ego[ego.VX]), 0.0) * self._times
        return Plan(waypoints)


class LogReplay(BasePlanner):
    """Waypoints are the logged poses of the coming 4 s.

    A rollout puts the ego onto the log's states, without a tracker: the replay is the log itself.
    Where the log ends within the 4 s, the plan goes on straight at the last logged speed; its
    `info` says how many waypoints that concerns.
    """

    name = "log-replay"
    needs_images = False
    replays_log = True

    def __init__(self) -> None:
        self._context: PlanningContext | None = None

    def reset(self, context: PlanningContext) -> None:
        """Take the logged trajectory."""
        self._context = context

    def plan(self, observation: PlannerInput) -> Plan:
        """The logged poses, seen from where the ego is now.

        Raises:
            RuntimeError: `reset` was not called.
        """
        if self._context is None:
            raise RuntimeError("LogReplay.plan: call reset first")
        log, dt = self._context.log, self._context.dt
        step_us = round(dt * 1e6)
        times = observation.timestamp_us + step_us * np.arange(1, WAYPOINTS + 1, dtype=np.int64)
        end = int(log.timestamps_us[-1])
        poses = se2.from_se3(log.at(np.minimum(times, end)))
        beyond = times > end
        if np.any(beyond):
            last = initial_state(log.timestamps_us, log.poses, end, self._context.vehicle, dt)
            distance = last[ego.VX] * (times[beyond] - end) * 1e-6
            ahead = np.stack([distance, np.zeros_like(distance), np.zeros_like(distance)], axis=-1)
            poses[beyond] = se2.compose(last[ego.POSE], ahead)
        return Plan(
            se2.relative(observation.ego[ego.POSE], poses),
            {"waypoints_beyond_log": float(np.count_nonzero(beyond))},
        )


PROBE_CURVATURES: Mapping[str, float] = {"straight": 0.0, "left-arc": 0.02, "right-arc": -0.02}
"""Curvature in 1/m by probe: positive turns left, y and heading grow."""


def arc(curvature: float, distance: ArrayLike) -> NDArray[np.float64]:
    """Poses (N, 3) on a circle through the origin at distances (N,) along it, in metres."""
    s = np.asarray(distance, np.float64)
    turn = curvature * s
    chord = s * np.sinc(turn / (2 * np.pi))
    return np.stack([chord * np.cos(turn / 2), chord * np.sin(turn / 2), turn], axis=-1)


class ProbePlanner(_Blind):
    """Drives an arc at its present speed, behind the simulator's own seam.

    Args:
        name: one of `PROBE_CURVATURES`.
    """

    def __init__(self, name: str) -> None:
        super().__init__()
        self.name = name
        self._curvature = PROBE_CURVATURES[name]

    def plan(self, observation: PlannerInput) -> Plan:
        """The arc for the coming 4 s."""
        return Plan(arc(self._curvature, float(observation.ego[ego.VX]) * self._times))


straight = partial(ProbePlanner, "straight")
left_arc = partial(ProbePlanner, "left-arc")
right_arc = partial(ProbePlanner, "right-arc")
