"""The centreline that PDM follows, and its proposals: an IDM at several speeds and offsets."""

from __future__ import annotations

import heapq
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from functools import cached_property
from itertools import pairwise

import numpy as np
import shapely
from numpy.typing import ArrayLike

from recast.arrays import Array, BoolArray, Int64Array
from recast.dynamics import IdmParameters, TrackerConfig, VehicleParameters, idm_step
from recast.dynamics import state as ego
from recast.dynamics.state import PDM_BATCH
from recast.dynamics.tracker import DEFAULT, PDM_REFERENCE
from recast.geometry import se2
from recast.planning.map import Block, PlannerLane, PlannerMap
from recast.planning.pdm.forecast import STRIDE, Forecast, box_corners

_START = 1e-5
_WINDOW = 30
"""Blocks of the route that the centreline covers."""
_ANGLE = np.pi / 4
_REACH = 1.0
_BACKWARD_DEPTH = 15
_FORWARD_DEPTH = 30
_REJOIN = 3
"""Number of first blocks of which one must be reached when none leads back to the start."""
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


DT = 0.1
"""Seconds per step. Its windows and look-aheads are counted in steps of this length."""
_MAX_SPEED = 5.0
_MAX_TIME = 2.0
_MIN_ACCELERATION, _MAX_ACCELERATION = -4.05, 2.4
_CRAWL = 0.2


@dataclass(frozen=True)
class PdmConfig:
    """Settings of PDM-Closed; the defaults are the published planner's.

    `reference_quirks` reproduces tuplan_garage to the last digit, its slips included. Off:

    - Lead: known from the first step on. The reference takes a standing lead at its own bumper for
      one step, which brakes with 3 m/s^2 for 0.1 s in every plan.
    - Lead of one proposal: its own. The reference carries speed and length over from the proposal
      before where it does not set them.
    - End of the route: the front bumper stops there, not half the ego's length from the rear axle.
    - Speed of a proposal: never below zero.
    - Corridor: begins and ends where it should, not at the nearest vertices of the centreline.
    - Simulation: nuPlan's jerk matrix instead of the defective one.
    - Comfort: nuPlan's smoothing windows, not one over the whole proposal.
    - Map: all of it, not only what comes within 50 m of the ego.
    - Equal scores: the path nearest to the ego wins, then the slower proposal. The reference takes
      the first in its list, the right-hand one before the left-hand one.
    - Emergency brake: never backwards and, at a crawl, never forwards; see `brake_plan`.

    Attributes:
        lateral_offsets: metres to the left of the centreline, of the paths beside it.
        speed_fractions: target speeds as shares of the speed limit.
        default_speed_limit: m/s, where the lane has none.
        proposal_steps: steps of a proposal, which is simulated and scored.
        plan_steps: steps of the plan, to which the best proposal is extended.
        radius: metres around the ego in which road users (and, with the quirks, the map) count.
    """

    reference_quirks: bool = False
    lateral_offsets: tuple[float, ...] = (-1.0, 1.0)
    speed_fractions: tuple[float, ...] = (0.2, 0.4, 0.6, 0.8, 1.0)
    default_speed_limit: float = 15.0
    idm: IdmParameters = PDM_BATCH
    proposal_steps: int = 40
    plan_steps: int = 80
    radius: float = 50.0

    @property
    def tracker(self) -> TrackerConfig:
        """The controller in the simulation of proposals."""
        return PDM_REFERENCE if self.reference_quirks else DEFAULT


class Unroll:
    """IDM states of all proposals; proposal = path index * number of speeds + speed index.

    Attributes:
        states: (P, plan_steps + 1, 2) progress in metres and speed in m/s.
        leads: (P, plan_steps + 1, 3) the lead's progress, speed, and the length to take off the
            gap, as used for the step to that index.

    Args:
        targets: (S,) target speeds in m/s, positive.
        state: (11,) state of the ego; starts each proposal at its projection, at its speed vx.
    """

    def __init__(
        self,
        paths: Sequence[Centreline],
        targets: ArrayLike,
        forecast: Forecast,
        state: ArrayLike,
        vehicle: VehicleParameters,
        config: PdmConfig,
    ) -> None:
        state = np.asarray(state, np.float64)
        self._paths, self._forecast = paths, forecast
        self._vehicle, self._config = vehicle, config
        speeds = np.asarray(targets, np.float64)
        self._per_path = len(speeds)
        self._targets = np.tile(speeds, len(paths))
        quirks = config.reference_quirks
        self._lengths = np.array([path.length for path in paths])
        self._reach = vehicle.length / 2 if quirks else vehicle.front_length
        shape = (len(self._targets), config.plan_steps + 1)
        self.states, self.leads = np.zeros((*shape, 2)), np.zeros((*shape, 3))
        start = np.array([float(path.project(state[ego.POSE])) for path in paths])
        self.states[:, 0, 0] = np.repeat(start, self._per_path)
        self.states[:, 0, 1] = state[ego.VX]
        reach = speeds.max() * config.plan_steps * DT
        stretches = [
            path.stretch(s, s + reach, vertices_only=quirks)
            for path, s in zip(paths, start, strict=True)
        ]
        self._corridors = shapely.buffer(stretches, vehicle.width / 2, cap_style="square")
        shapely.prepare(self._corridors)
        self._advance(np.arange(len(self._targets)), 1, config.proposal_steps)

    def extend(self, proposal: int) -> None:
        """Unroll one proposal to the length of a plan."""
        first = self._config.proposal_steps + 1
        self._advance(np.array([proposal]), first, self._config.plan_steps)

    def poses(self, proposals: Sequence[int], steps: int) -> Array:
        """World poses (len(proposals), steps + 1, 3) of the rear axle on the paths."""
        rows = np.asarray(proposals)
        return self._on_paths(rows, self.states[rows, : steps + 1, 0])

    def _on_paths(self, rows: Int64Array, progress: Array) -> Array:
        """Poses (R, ..., 3) at progress (R, ...) of some proposals (R,), each on its own path."""
        found = np.empty((*progress.shape, 3))
        which = rows // self._per_path
        for i in set(which.tolist()):
            found[which == i] = self._paths[i].at(progress[which == i])
        return found

    def _advance(self, rows: Int64Array, first: int, last: int) -> None:
        """Unroll some proposals (R,) side by side, from one step to another."""
        config, targets = self._config, self._targets[rows]
        offset = first // STRIDE
        places = self._places(np.unique(rows // self._per_path), offset, last // STRIDE)
        state, lead = self.states[rows, first - 1], self.leads[rows, first - 1]
        for step in range(first, last + 1):
            if step % STRIDE == 0 or (step == 1 and not config.reference_quirks):
                lead = self._lead(rows, state[:, 0], places[:, step // STRIDE - offset], step)
            state = idm_step(state, lead, targets, config.idm, DT)
            if not config.reference_quirks:
                np.maximum(state[:, 1], 0.0, out=state[:, 1])
            self.states[rows, step], self.leads[rows, step] = state, lead

    def _places(self, paths: Int64Array, first: int, last: int) -> Array:
        """Where obstacles are along the paths: progress (all paths, maps, n) of their centroids.

        Minus infinity for other paths, and outside of the corridor.

        Args:
            paths: (K,) indices.
            first, last: maps of the forecast, both included.
        """
        forecast, shapes = self._forecast, self._forecast.polygons[first : last + 1]
        places = np.full((len(self._paths), *shapes.shape), -np.inf)
        stands = forecast.speeds == 0.0
        # What stands is at one place in all maps: there it is looked for once.
        for columns, maps in ((stands, shapes[:1]), (~stands, shapes)):
            inside = shapely.intersects(self._corridors[paths, None, None], maps[:, columns])
            inside &= ~forecast.ignored[columns]
            for i, found in zip(paths.tolist(), inside, strict=True):
                centres = shapely.get_coordinates(shapely.centroid(maps[:, columns][found]))
                progress = np.full(found.shape, -np.inf)
                progress[found] = self._paths[i].project(centres)
                places[i][:, columns] = progress
        return places

    def _lead(self, rows: Int64Array, before: Array, places: Array, step: int) -> Array:
        """The leads (R, 3) of proposals at progress (R,), by `_places` (all paths, n) at a step."""
        path = rows // self._per_path
        lead = np.zeros((len(rows), 3))
        lead[:, 0] = self._lengths[path]
        lead[:, 2] = self._reach
        ahead = places[path] > before[:, None]
        follows = np.asarray(ahead.any(axis=1))
        if not follows.any():
            return lead
        forecast, shapes = self._forecast, self._forecast.at(step)
        followers = np.flatnonzero(follows)
        poses = self._on_paths(rows[followers], before[followers])
        outlines = shapely.polygons(box_corners(poses, self._vehicle))
        gaps = np.full((len(followers), len(shapes)), np.inf)
        i, k = np.nonzero(ahead[followers])
        gaps[i, k] = shapely.distance(outlines[i], shapes[k])
        nearest = gaps.argmin(axis=1)
        lead[followers, 0] = before[followers] + gaps.min(axis=1)
        lead[followers, 1] = forecast.speeds[nearest] * np.cos(
            poses[:, 2] - forecast.headings[nearest]
        )
        lead[followers, 2] = 0.0
        red = np.zeros(len(rows), np.bool_)
        red[followers] = forecast.red[nearest]
        lead[red, 1] = 0.0
        if self._config.reference_quirks:
            lead[:, 1] = _carried_over(lead[:, 1], ~red, path)
            lead[:, 2] = _carried_over(lead[:, 2], ~follows, path)
        return lead


def _carried_over(values: Array, given: BoolArray, path: Int64Array) -> Array:
    """Values (R,) where given, else the last given one before on the same path, else 0.

    Args:
        path: (R,) indices, not falling.
    """
    last = np.maximum.accumulate(np.where(given, np.arange(len(values)), -1))
    return np.where(last >= np.searchsorted(path, path), values[last], 0.0)


def brakes(speed: float, collision_time: float) -> bool:
    """Whether to brake: at 5 m/s or less, within 2 s of the best proposal's at-fault collision."""
    return speed <= _MAX_SPEED and collision_time <= _MAX_TIME


def brake_plan(state: Array, steps: int, dt: float, *, reference_quirks: bool) -> Array:
    """Poses (steps + 1, 3) straight ahead at a constant speed near zero.

    From the speed v, at more than 0.2 m/s: 1.1 (v + clip(-10 v, -4.05, 2.4)), else, with the
    acceleration a, clip(-4 v - a, -4.05, 2.4). Below 4.05 m/s the former is negative: the
    reference creeps backwards. With quirks off, speeds below zero are 0, and so is all of the
    latter, which would start a standing ego that has just braked.

    Args:
        state: (11,) state of the ego.
    """
    speed, acceleration = float(state[ego.VX]), float(state[ego.AX])
    if speed > _CRAWL:
        change = np.clip(-10.0 * speed, _MIN_ACCELERATION, _MAX_ACCELERATION)
        target = 1.1 * (speed + change)
    else:
        target = np.clip(-4.0 * speed - acceleration, _MIN_ACCELERATION, _MAX_ACCELERATION)
    if not reference_quirks:
        target = max(target, 0.0) if speed > _CRAWL else 0.0
    ahead = np.zeros((steps + 1, 3))
    ahead[:, 0] = target * dt * np.arange(steps + 1)
    return se2.compose(state[ego.POSE], ahead)
