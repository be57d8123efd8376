"""An ego that moves over: recast run LOG --planner examples.changes_lanes:ChangesLanes ..."""

from dataclasses import replace

import numpy as np

from recast.geometry.se2 import Polyline
from recast.planning import IdmLaneFollower, Plan, PlannerInput, PlanningContext
from recast.planning.types import ReferenceRoute

BEGIN, LENGTH, ACROSS = 10.0, 40.0, 3.0  # metres from the start, along the road, to the left


class ChangesLanes(IdmLaneFollower):
    """Keeps its distance as `idm-follower` does, on the recorded way moved over by a quintic."""

    name = "changes-lanes"

    def reset(self, context: PlanningContext) -> None:
        self.context, self.moved = context, False

    def plan(self, observation: PlannerInput) -> Plan:
        if not self.moved:  # the first plan tells where the drive begins
            start = float(self.context.route.project(observation.ego.pose)[0])
            super().reset(replace(self.context, route=moved_over(self.context.route, start)))
            self.moved = True
        return super().plan(replace(observation, route_s=None))


def moved_over(route: ReferenceRoute, start: float) -> ReferenceRoute:
    s = np.arange(0.0, route.length, 0.5)
    share = np.clip((s - start - BEGIN) / LENGTH, 0.0, 1.0)
    line = Polyline(route.pose(s, ACROSS * share**3 * (10 - 15 * share + 6 * share**2))[:, :2])
    step = np.gradient(line.points, axis=0)
    headings = np.unwrap(np.arctan2(step[:, 1], step[:, 0]))
    return ReferenceRoute(line, headings, route.logged_speed(s))
