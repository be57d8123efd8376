"""The lane that the ego is on, and the centreline from there along the route, which is mended."""

from __future__ import annotations

import heapq
from collections.abc import Mapping, Sequence
from functools import cached_property
from itertools import pairwise

import numpy as np
import shapely
from numpy.typing import ArrayLike

from recast.arrays import Array
from recast.geometry import se2
from recast.planning.map import Block, PlannerLane, PlannerMap

_START = 1e-5
_WINDOW = 30
"""Blocks of the route that the centreline covers."""
_ANGLE = np.pi / 4
_REACH = 1.0
_BACKWARD_DEPTH = 15
_FORWARD_DEPTH = 30
_REJOIN = 3
"""Of how many first blocks one must be reached when none leads back to the start."""
_LOOP_AREA = 1.0
"""Square metres that two connectors of a route may share before it counts as a loop."""


class Centreline:
    """Poses joined by straight chords; unlike `Polyline`, neighbours may be equal.

    They are where a lane ends and the next one begins.

    Args:
        poses: (N, 3) x, y, heading; N >= 2.
    """

    def __init__(self, poses: ArrayLike) -> None:
        self.poses = np.array(poses, np.float64)
        self.poses[:, 2] = np.unwrap(self.poses[:, 2])
        steps = np.linalg.norm(np.diff(self.poses[:, :2], axis=0), axis=1)
        self.progress = np.concatenate([[0.0], np.cumsum(steps)])

    @property
    def length(self) -> float:
        """Metres from end to end."""
        return float(self.progress[-1])

    @cached_property
    def line(self) -> shapely.LineString:
        """The chords as a shapely line."""
        line = shapely.LineString(self.poses[:, :2])
        shapely.prepare(line)
        return line

    def at(self, progress: ArrayLike) -> Array:
        """Poses (..., 3) at progress (...) in metres, which is limited to [1e-5, length]."""
        s = np.clip(np.asarray(progress, np.float64), _START, self.length)
        x, y, heading = (np.interp(s, self.progress, self.poses[:, k]) for k in range(3))
        return np.stack([x, y, se2.wrap_angle(heading)], axis=-1)

    def project(self, points: ArrayLike) -> Array:
        """Progress (...) in metres of the path points nearest to points (..., >=2)."""
        points = shapely.points(np.asarray(points, np.float64)[..., :2])
        return np.asarray(shapely.line_locate_point(self.line, points), np.float64)

    def stretch(self, start: float, end: float, *, vertices_only: bool) -> shapely.Geometry:
        """The part between two progress values, as a line (or a point where it has no length).

        Args:
            start, end: metres, limited to the path.
            vertices_only: leave out the pieces between the ends and the nearest vertices inside,
                unless fewer than two vertices remain (tuplan_garage).
        """
        start, end = np.clip([start, end], 0.0, self.length)
        inside = (start <= self.progress) & (self.progress <= end)
        if vertices_only and np.count_nonzero(inside) >= 2:
            return shapely.LineString(self.poses[inside, :2])
        ends = shapely.line_interpolate_point(self.line, [start, end])
        if start == end:
            return ends[0]
        first, last = shapely.get_coordinates(ends)
        between = self.poses[(start < self.progress) & (self.progress < end), :2]
        return shapely.LineString(np.vstack([first, between, last]))

    def shifted(self, offset: float) -> Centreline:
        """The parallel path `offset` metres to the left; every pose keeps its heading."""
        moved = self.poses.copy()
        moved[:, 0] += offset * np.cos(moved[:, 2] + np.pi / 2)
        moved[:, 1] += offset * np.sin(moved[:, 2] + np.pi / 2)
        return Centreline(moved)


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
        rear_axle: (3,) pose of the rear axle.
        centre: (>=2,) centre of the ego's box.
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


def route_centreline(
    planner_map: PlannerMap, route: Sequence[str], start: PlannerLane
) -> Centreline:
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
    return Centreline(np.concatenate([planner_map.lanes[k].centreline for k in reversed(chain)]))


def repair_route(planner_map: PlannerMap, route: Sequence[str], start: str | None) -> list[str]:
    """Blocks of a route that begins where the ego is and has neither gaps nor loops, if possible.

    - Where the ego's block is not on it, the blocks from there to its first one are put in front;
      failing that, those to one of its first three, which then becomes the first.
    - Between two blocks that do not follow on each other, those in between are put in.
    - It ends before a connector that overlaps one of an earlier intersection by more than 1 m^2.

    Source: tuplan_garage's route correction. There an intersection is crossed on one connector;
    here connectors may follow on each other, and overlap where they do.

    Args:
        route: block ids in order, at least one.
        start: the ego's block, or None where it is on none.
    """
    blocks = planner_map.blocks
    mended = list(dict.fromkeys(route))
    if start is not None and start not in mended:
        mended = _from_start(blocks, mended, start)
    filled = mended[:1]
    for here, following in pairwise(mended):
        between = _search(blocks, here, {following}, _FORWARD_DEPTH)
        filled += [following] if between is None else between[1:]
    return _without_loops(planner_map, list(dict.fromkeys(filled)))


def _from_start(blocks: Mapping[str, Block], route: list[str], start: str) -> list[str]:
    back = _search(blocks, route[0], {start}, _BACKWARD_DEPTH, backward=True)
    if back is not None:
        return back[:0:-1] + route
    ahead = _search(blocks, start, set(route[:_REJOIN]), _FORWARD_DEPTH)
    if ahead is None:
        return route
    return ahead + route[route.index(ahead[-1]) + 1 :]


def _search(
    blocks: Mapping[str, Block], start: str, goals: set[str], depth: int, *, backward: bool = False
) -> list[str] | None:
    """Shortest chain of at most `depth` blocks from start to a goal, both included, or None."""
    came_from = {start: ""}
    layer = [start]
    for _ in range(depth - 1):
        reached: list[str] = []
        for key in layer:
            for other in blocks[key].predecessors if backward else blocks[key].successors:
                if other in came_from:
                    continue
                came_from[other] = key
                if other in goals:
                    chain = [other]
                    while came_from[chain[-1]]:
                        chain.append(came_from[chain[-1]])
                    return chain[::-1]
                reached.append(other)
        layer = reached
    return None


def _without_loops(planner_map: PlannerMap, route: list[str]) -> list[str]:
    earlier: list[shapely.Geometry] = []
    here: list[shapely.Geometry] = []
    for i, key in enumerate(route):
        block = planner_map.blocks[key]
        if not block.connector:
            earlier, here = earlier + here, []
            continue
        area = shapely.union_all([planner_map.lanes[lane].polygon for lane in block.lane_ids])
        if any(shapely.area(shapely.intersection(area, old)) > _LOOP_AREA for old in earlier):
            return route[:i]
        here.append(area)
    return route
