"""A straight road, and cars that go straight on, for the scores of a vocabulary."""

from __future__ import annotations

import numpy as np
import shapely

from recast.planning.gtrs.expert import FORESEEN, TargetObstacle, TargetRoad
from recast.planning.map import PlannerLane, PlannerMap
from recast.planning.pdm import Centreline


def straight_road(speed: float = 10.0) -> TargetRoad:
    """One lane 3.6 m wide along x from -50 to 200 m, with a metre of shoulder on both sides."""
    line = np.stack([np.arange(-50.0, 200.5, 0.5), np.zeros(501), np.zeros(501)], axis=1)
    lane = PlannerLane("lane", "block", line, shapely.box(-50, -1.8, 200, 1.8))
    planner_map = PlannerMap({"lane": lane}, drivable=[shapely.box(-50, -2.8, 200, 2.8)])
    return TargetRoad(planner_map, ("lane",), Centreline(line), np.full(len(line), speed))


def moving(x: float, y: float = 0.0, heading: float = 0.0, speed: float = 0.0) -> TargetObstacle:
    """A car whose middle is there now and goes on straight."""
    way = 0.1 * speed * np.arange(FORESEEN + 1)[:, None] * [np.cos(heading), np.sin(heading)]
    poses = np.concatenate([way + np.array([x, y]), np.full((FORESEEN + 1, 1), heading)], axis=1)
    return TargetObstacle("car", poses, np.array([4.5, 1.9, 1.5]))
