"""PDM-Closed on the planner seam."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from recast.dynamics import state as ego
from recast.errors import InputError
from recast.geometry import se2
from recast.planning.map import continued_route, planner_map, route_blocks
from recast.planning.pdm.closed import PdmClosed
from recast.planning.pdm.forecast import Obstacle
from recast.planning.pdm.settings import DT, PdmConfig
from recast.planning.types import WAYPOINTS, Plan, PlannerInput, PlanningContext

Array = NDArray[np.float64]

_BEYOND = 120.0
"""Metres of route beyond the log's: 8 s at 15 m/s, so that its end is not braked for too early."""


class PdmClosedPlanner:
    """State-conditioned: reads boxes, velocities and the map; nothing of the log but its route.

    The route goes straight on where the log ends, as far as the map does; at its end the ego stops.
    Logs hold no traffic lights, so none are seen here; `PdmClosed.plan` takes them. `Plan.info`
    holds the proposal chosen, its score and metrics, and whether the emergency brake took over.
    """

    name = "pdm-closed"
    needs_images = False

    def __init__(self, config: PdmConfig | None = None) -> None:
        self.config = config or PdmConfig()
        self._pdm: PdmClosed | None = None
        self._times: Array = DT * np.arange(1, WAYPOINTS + 1, dtype=np.float64)

    def reset(self, context: PlanningContext) -> None:
        """Adapt the map and find the route on it.

        Raises:
            InputError: there is no map, it has no lanes, or the route does not lie on it; or the
                waypoints are so far apart that they reach beyond its 8 s.
        """
        if context.map is None:
            raise InputError(
                "planner pdm-closed",
                "map",
                "the log has none",
                "use a log with a map, or derive one from the drive",
            )
        self._times = np.asarray(context.dt * np.arange(1, WAYPOINTS + 1), np.float64)
        planned = DT * self.config.plan_steps
        if self._times[-1] > planned + 1e-9:
            raise InputError(
                "planner pdm-closed", "dt",
                f"is {context.dt:g} s: {WAYPOINTS} waypoints reach beyond its {planned:g} s",
                f"simulate with dt {planned / WAYPOINTS:g} or less",
            )  # fmt: skip
        lanes = planner_map(context.map)
        route = continued_route(lanes, route_blocks(lanes, context.route), _BEYOND)
        self._pdm = PdmClosed(lanes, route, context.vehicle, self.config)

    def plan(self, observation: PlannerInput) -> Plan:
        """The first 40 waypoints of the plan, 4 s with `dt` 0.1; other steps lie between its own.

        Raises:
            InputError: at the first call, the ego is not near the route.
            RuntimeError: `reset` was not called.
        """
        if self._pdm is None:
            raise RuntimeError("PdmClosedPlanner.plan: call reset first")
        found = self._pdm.plan(
            observation.ego, [Obstacle.from_actor(actor) for actor in observation.actors]
        )
        ahead = _at(found.trajectory, self._times)
        best, scores = found.best, found.scores
        return Plan(
            se2.relative(observation.ego[ego.POSE], ahead),
            {
                "proposal": float(best),
                "emergency_brake": float(found.braked),
                "score": float(scores.total[best]),
                "no_collision": float(scores.no_collision[best]),
                "drivable": float(scores.drivable[best]),
                "direction": float(scores.direction[best]),
                "progress": float(scores.progress[best]),
                "ttc": float(scores.ttc[best]),
                "comfort": float(scores.comfort[best]),
            },
        )


def _at(trajectory: Array, times: Array) -> Array:
    """Poses (N, 3) at some seconds along a trajectory (T, 3) of steps of `DT`."""
    steps = np.rint(times / DT).astype(np.int64)
    if np.allclose(times, DT * steps, rtol=0.0, atol=1e-9):
        return trajectory[steps]
    known = DT * np.arange(len(trajectory))
    columns = (trajectory[:, 0], trajectory[:, 1], np.unwrap(trajectory[:, 2]))
    return np.stack([np.interp(times, known, column) for column in columns], axis=-1)
