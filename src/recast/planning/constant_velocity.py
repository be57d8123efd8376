"""Straight ahead at the present speed: the least a planner can do."""

from __future__ import annotations

import numpy as np

from recast.dynamics import state as ego
from recast.planning.types import WAYPOINTS, Plan, PlannerInput, PlanningContext


class ConstantVelocity:
    """Keeps heading and speed; sees nothing."""

    name = "constant-velocity"
    needs_images = False

    def __init__(self) -> None:
        self._times = 0.1 * np.arange(1, WAYPOINTS + 1)

    def reset(self, context: PlanningContext) -> None:
        """Take the time step."""
        self._times = context.dt * np.arange(1, WAYPOINTS + 1)

    def plan(self, observation: PlannerInput) -> Plan:
        """Waypoints on the ego's x axis."""
        waypoints = np.zeros((WAYPOINTS, 3))
        waypoints[:, 0] = max(float(observation.ego[ego.VX]), 0.0) * self._times
        return Plan(waypoints)
