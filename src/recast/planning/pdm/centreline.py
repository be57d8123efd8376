"""The lane that the ego is on, and the centreline from there along the route."""

from __future__ import annotations

import heapq
from collections.abc import Sequence

import numpy as np
import shapely
from numpy.typing import ArrayLike, NDArray

from recast.geometry import se2
from recast.planning.map import PlannerLane, PlannerMap
from recast.planning.pdm.lane_path import LanePath

Array = NDArray[np.float64]

_WINDOW = 30
"""Blocks of the route that the centreline covers."""
_ANGLE = np.pi / 4
_REACH = 1.0


def start_block(planner_map: PlannerMap, pose: ArrayLike, route: Sequence[str]) -> str | None:
    """The block of the ego pose (3,), or None where there is none.

    Of the lanes within 1 m and 45 degrees: one on the route first, then the one with the nearest
    centreline.
    """
    pose = np.asarray(pose, np.float64)
    found = []
    for key in planner_map.lanes_at(pose, _REACH):
        lane = planner_map.lanes[key]
        if heading_error(lane, pose) <= _ANGLE:
            distance = np.linalg.norm(lane.centreline[:, :2] - pose[:2], axis=1).min()
            found.append((lane.block_id not in route, float(distance), lane.block_id))
    return min(found)[2] if found else None


def start_lane(
    planner_map: PlannerMap,
    route_lanes: Sequence[str],
    rear_axle: ArrayLike,
    centre: ArrayLike,
    outline: shapely.Polygon,
) -> PlannerLane:
    """The lane of the route that the ego is on.

    Of the route's lanes under the rear axle the one with the least heading error; else the first
    that holds the box centre; else the one nearest to the ego's outline.

    Args:
        route_lanes: ids, at least one.
        rear_axle: (3,) pose.
        centre: (>=2,) of the ego's box.
        outline: of the ego's box.
    """
    rear_axle, centre = np.asarray(rear_axle, np.float64), np.asarray(centre, np.float64)
    on_route = set(route_lanes)
    under = [planner_map.lanes[k] for k in planner_map.lanes_at(rear_axle) if k in on_route]
    if under:
        return min(under, key=lambda lane: heading_error(lane, rear_axle))
    lanes = [planner_map.lanes[key] for key in route_lanes]
    for lane in lanes:
        if shapely.contains_xy(lane.polygon, centre[0], centre[1]):
            return lane
    return min(lanes, key=lambda lane: shapely.distance(lane.polygon, outline))


def heading_error(lane: PlannerLane, pose: Array) -> float:
    """Radians, not negative, between a pose (3,) and the nearest pose of the lane's centreline."""
    nearest = np.argmin(np.linalg.norm(lane.centreline[:, :2] - pose[:2], axis=1))
    return abs(float(se2.wrap_angle(lane.centreline[nearest, 2] - pose[2])))


def route_centreline(planner_map: PlannerMap, route: Sequence[str], start: PlannerLane) -> LanePath:
    """Centrelines of the shortest chain of lanes from `start` to the last block of the route.

    Dijkstra over the route's lanes, each costing its length, within the next 30 blocks. Where that
    block cannot be reached, the chain leads to the reachable block farthest along the route.
    """
    first = list(route).index(start.block_id)
    window = {block: i for i, block in enumerate(route[first : first + _WINDOW])}
    allowed = set(planner_map.lanes_of(route))
    came_from: dict[str, str] = {}
    cost = {start.lane_id: start.length}
    queue = [(start.length, start.lane_id)]
    best, rank = start.lane_id, 0
    while queue:
        spent, key = heapq.heappop(queue)
        if spent > cost[key]:
            continue
        place = window.get(planner_map.lanes[key].block_id, -1)
        if place > rank:
            best, rank = key, place
            if place == len(window) - 1:
                break
        for other in planner_map.lanes[key].successors:
            total = spent + planner_map.lanes[other].length
            if other in allowed and total < cost.get(other, np.inf):
                cost[other], came_from[other] = total, key
                heapq.heappush(queue, (total, other))
    chain = [best]
    while chain[-1] in came_from:
        chain.append(came_from[chain[-1]])
    return LanePath(np.concatenate([planner_map.lanes[k].centreline for k in reversed(chain)]))
