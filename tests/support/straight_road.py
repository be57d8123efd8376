"""A straight road with a crossing, and egos and road users on it, made by hand."""

from __future__ import annotations

import numpy as np
import shapely

from recast.dynamics import state as ego
from recast.logs.hdmap import HdMap, Lane
from recast.planning.map import PlannerLane, PlannerMap
from recast.planning.pdm import AgentKind, Centreline, Obstacle, observed

STATES = 41
TIMES = 0.1 * np.arange(STATES)
CROSSING = (100.0, 130.0)
ROUTE_LANES = ("ahead", "across", "beyond")
CENTRELINE = Centreline(np.array([[x, 0.0, 0.0] for x in np.arange(-50.0, 201.0, 1.0)]))


def road() -> PlannerMap:
    """Lanes of 3.5 m along x: the route's at y = 0, the oncoming one at y = 3.5."""

    def lane(key, start, end, y, heading, connector=False, successors=()):
        x = np.linspace(start, end, round(abs(end - start)) + 1)
        poses = np.stack([x, np.full_like(x, y), np.full_like(x, heading)], axis=-1)
        left, right = sorted((start, end))
        outline = shapely.box(left, y - 1.75, right, y + 1.75)
        return PlannerLane(key, key, poses, outline, 15.0, successors, connector)

    first, last = CROSSING
    lanes = [
        lane("ahead", -50.0, first, 0.0, 0.0, successors=("across",)),
        lane("across", first, last, 0.0, 0.0, connector=True, successors=("beyond",)),
        lane("beyond", last, 200.0, 0.0, 0.0),
        lane("oncoming", 200.0, -50.0, 3.5, np.pi),
    ]
    crossing = shapely.box(first, -5.0, last, 8.0)
    return PlannerMap({one.lane_id: one for one in lanes}, intersections=[crossing])


def straight(speed, x=0.0, y=0.0, acceleration=0.0, yaw_rate=0.0) -> np.ndarray:
    """States (41, 11) along x; a yaw rate turns the heading alone."""
    states = np.zeros((STATES, ego.SIZE))
    states[:, ego.X] = x + speed * TIMES + acceleration * TIMES**2 / 2
    states[:, ego.Y] = y
    states[:, ego.HEADING] = yaw_rate * TIMES
    states[:, ego.VX] = speed + acceleration * TIMES
    states[:, ego.AX] = acceleration
    states[:, ego.ANGULAR_VELOCITY] = yaw_rate
    return states


def user(x, y=0.0, speed=0.0, kind=AgentKind.VEHICLE, size=(4.0, 2.0), token="v") -> Obstacle:
    """A road user that heads along x."""
    return Obstacle(
        token, kind, np.array([x, y, 0.0]), np.array([speed, 0.0]), np.array(size, np.float64)
    )


def seen(*users: Obstacle, red=()):
    """They keep their speed for 41 steps."""
    poses = np.zeros((len(users), STATES, 3))
    for one, path in zip(users, poses, strict=True):
        path[:] = one.pose
        path[:, 0] += one.velocity[0] * TIMES
    return observed(users, poses, red)


def hd_road() -> HdMap:
    """The same road as a log's map."""

    def lane(key, start, end, y, successors=(), crossing=False):
        x = np.array([start, end], np.float64)
        way = np.sign(end - start)

        def line(aside):
            return np.stack([x, np.full(2, y + way * aside), np.zeros(2)], axis=-1)

        left, right = line(1.75), line(-1.75)
        outline = np.concatenate([right, left[::-1]])[:, :2]
        middle = line(0.0)
        return Lane(key, middle, left, right, outline, 15.0, successors, is_intersection=crossing)

    first, last = CROSSING
    lanes = [
        lane("ahead", -50.0, first, 0.0, ("across",)),
        lane("across", first, last, 0.0, ("beyond",), True),
        lane("beyond", last, 200.0, 0.0),
        lane("oncoming", 200.0, -50.0, 3.5),
    ]
    return HdMap({one.lane_id: one for one in lanes}, ())
