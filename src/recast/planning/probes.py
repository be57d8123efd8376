"""Planners whose motion is known in advance, to prove frame conventions.

Each can be named, as `--planner recast.planning.probes:left_arc`. Their counterparts behind the
NAVSIM seam are in `recast.planning.navsim.probes`; `recast.simulation.probe_path` drives any
planner over an empty plane and says where it went.
"""

from __future__ import annotations

from collections.abc import Mapping

import numpy as np
from numpy.typing import ArrayLike, NDArray

from recast.dynamics import state as ego
from recast.planning.types import WAYPOINTS, Plan, PlannerInput, PlanningContext

PROBE_CURVATURES: Mapping[str, float] = {"straight": 0.0, "left-arc": 0.02, "right-arc": -0.02}
"""Curvature in 1/m by probe: positive turns left, y and heading grow."""


def arc(curvature: float, distance: ArrayLike) -> NDArray[np.float64]:
    """Poses (N, 3) on a circle through the origin at distances (N,) along it, in metres."""
    s = np.asarray(distance, np.float64)
    turn = curvature * s
    chord = s * np.sinc(turn / (2 * np.pi))
    return np.stack([chord * np.cos(turn / 2), chord * np.sin(turn / 2), turn], axis=-1)


class ProbePlanner:
    """Drives an arc at its present speed, behind the simulator's own seam.

    Args:
        name: one of `PROBE_CURVATURES`.
    """

    needs_images = False

    def __init__(self, name: str) -> None:
        self.name = name
        self._curvature = PROBE_CURVATURES[name]
        self._times = 0.1 * np.arange(1, WAYPOINTS + 1)

    def reset(self, context: PlanningContext) -> None:
        """Take the time step."""
        self._times = context.dt * np.arange(1, WAYPOINTS + 1)

    def plan(self, observation: PlannerInput) -> Plan:
        """The arc for the coming 4 s."""
        return Plan(arc(self._curvature, float(observation.ego[ego.VX]) * self._times))


def straight() -> ProbePlanner:
    """Keeps its course."""
    return ProbePlanner("straight")


def left_arc() -> ProbePlanner:
    """Turns left."""
    return ProbePlanner("left-arc")


def right_arc() -> ProbePlanner:
    """Turns right."""
    return ProbePlanner("right-arc")
