"""Drives what the log drove, in time and place, whatever the others do."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from recast.dynamics import initial_state
from recast.dynamics import state as ego
from recast.geometry import se2
from recast.planning.types import WAYPOINTS, Plan, PlannerInput, PlanningContext

Array = NDArray[np.float64]


class LogReplay:
    """Waypoints are the logged poses of the coming 4 s.

    Where the log ends within the 4 s, the plan goes on straight at the last logged speed; its
    `info` says how many waypoints that concerns.
    """

    name = "log-replay"
    needs_images = False

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
