"""The expert that planners of motion primitives learn from, and how it scores them.

Sub-scores of every trajectory where it is known what comes, and the best of them. Collisions are
scored for hundreds of trajectories at once, against known futures: the same verdicts as
`recast.planning.pdm.scorer` gives where the ego is always to blame for contacts from the side (its
areas say "multiple lanes" everywhere), by arithmetic on boxes instead of tests of polygons; but
to be run into while standing, up to 2 s after a trajectory's end, is half a fault.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace

import numpy as np
import shapely
from numpy.typing import NDArray

from recast.arrays import Array
from recast.core.errors import InputError
from recast.dynamics import PACIFICA, VehicleParameters, plan_to_poses, track
from recast.dynamics import state as ego
from recast.geometry import se2
from recast.geometry.boxes import bev_touching
from recast.logs import HdMap
from recast.planning.gtrs.config import PRIMITIVES
from recast.planning.gtrs.scores import METRICS, comfortable
from recast.planning.map import PlannerMap, planner_map, route_blocks
from recast.planning.pdm import Centreline
from recast.planning.pdm.forecast import box_centres, box_corners
from recast.planning.pdm.scorer import direction_compliance, ego_areas
from recast.planning.types import (
    WAYPOINTS,
    ActorState,
    BasePlanner,
    DrivingCommand,
    Plan,
    PlannerInput,
    PlanningContext,
    ReferenceRoute,
    ego_status,
)

FORESEEN = WAYPOINTS + 20
"""Steps that obstacles are known ahead: the time to collision looks 0.9 s beyond a trajectory, and
where it ends nothing shall come to in 2 s."""

_LOOK_AHEAD = np.array([0, 3, 6, 9])
_STOPPED, _STOPPED_TTC = 0.05, 0.005
_BEHIND, _AHEAD = np.deg2rad(150), np.deg2rad(30)
SCORED = METRICS[:6]
"""Heads with targets of their own, in their order; the last one, traffic lights, is always 1."""
STRIDE = 2
"""Steps between looks at areas and lanes."""

_ALONG, _ACROSS = 0.5, 0.1
"""Metres by which obstacles count as longer at each end, and wider at each side, than they are:
what only just fits is not to be learnt."""
_OFF_LANE, _OFF_LANE_STEPS = 0.5, 20
"""Metres off the middle, and steps running: NAVSIM's lane keeping."""
_LEAVES = 1.0
"""Metres off the middle that are too much at once."""
_LEAST_PROGRESS = 5.0
_BLOCKED, _RESERVE = 4.0, 2.5
"""Metres up to which it is better to stand than to creep closer; and that a driver leaves to what
is in the way: who stops as late as is safe, is touched where distance or speed were misread."""
_FULL = 255
_RUN_INTO, _AS_GOOD_AS_STANDING = 0.5, 0.5
"""No-collision score where the ego already stands when an obstacle ahead or beside drives into it:
blameless by nuPlan's rule, yet to have stopped earlier is better. And m/s below which it stands at
the end of a trajectory: the tracker creeps to a standstill."""
_DT = 0.1
_SLOWEST = 3.0
"""m/s wanted where the log drove slower: it starts at a crawl in places."""


@dataclass(frozen=True)
class TargetRoad:
    """Where the ego shall go.

    Attributes:
        map: lanes and drivable area.
        lanes: ids of the lanes of the route.
        middle: path on which progress and lane keeping are measured.
        speeds: (N,) wanted speeds at the path's poses, m/s.
    """

    map: PlannerMap
    lanes: tuple[str, ...]
    middle: Centreline
    speeds: Array


def target_road(route: ReferenceRoute, hd_map: HdMap) -> TargetRoad:
    """Where a driver of a route shall go, at the speeds of its log."""
    lanes = planner_map(hd_map)
    places = np.linspace(0.0, route.length, int(2 * route.length) + 1)
    return TargetRoad(
        map=lanes,
        lanes=lanes.lanes_of(route_blocks(lanes, route)),
        middle=Centreline(route.pose(places)),
        speeds=np.maximum(route.logged_speed(places), _SLOWEST),
    )


@dataclass(frozen=True)
class TrajectoryTargets:
    """Scores of trajectories in one situation.

    Attributes:
        scores: (6, L) uint8, 255 for 1, in the order of `SCORED`.
        total: (L,) NC DAC DDC (5 TTC + 5 EP + 2 LK + 2 C) / 14.
        best: index of the best trajectory, see `steady_best`.
    """

    scores: NDArray[np.uint8]
    total: Array
    best: int


_COMPARED, _SPREAD = (19, 39), np.array([[1.5, 0.2], [4.0, 0.4]])
"""Waypoints, at 2 and 4 s, by which trajectories are neighbours, and the standard deviations,
metres ahead and aside, with which they may be missed."""


def steady_best(trajectories: NDArray[np.float32], totals: Array, safe: Array) -> NDArray[np.int64]:
    """The trajectories (N,) that are best even if they are missed by a little.

    The highest score is often at an edge: the latest braking that just suffices. Who learns from
    images cannot drive that exactly. So each score is multiplied by the share of the neighbours
    that are safe; where all are, on a free road, the best remains the best.

    Args:
        trajectories: (N, L, 40, 3).
        totals: (N, L) scores.
        safe: (N, L) products of no collision and time to collision.
    """
    places = (trajectories[:, :, _COMPARED, :2] / _SPREAD).reshape(*totals.shape, -1)
    squares = (places**2).sum(axis=-1)
    apart = squares[:, :, None] + squares[:, None] - 2.0 * places @ places.swapaxes(1, 2)
    near = np.exp(-0.5 * np.maximum(apart, 0.0))
    around = (near @ safe[..., None])[..., 0] / near.sum(axis=-1)
    return np.asarray((totals * around).argmax(axis=-1))


def score_trajectories(
    trajectories: NDArray[np.float32],
    state: Array,
    road: TargetRoad,
    obstacles: Sequence[TargetObstacle],
    vehicle: VehicleParameters = PACIFICA,
) -> TrajectoryTargets:
    """Drive every trajectory with the LQR tracker and score it by PDM's rules.

    Obstacles move as they truly will, not at constant velocity. Beyond PDM: touching an obstacle
    sideways is always the ego's fault, and being run into from ahead while standing half a fault,
    since the closed loop counts every collision. Progress is compared with what the wanted speeds
    allow, or, if that is less, with 2.5 m less than the best that gets through in its lane; more is
    as bad as less, so that braking beats swerving. Lane keeping is NAVSIM's, not more than 0.5 m
    off for 2 s running, and never more than 1 m off where it was not. Comfort is that of the
    trajectory and of the path driven by it, see `comfortable`: of two that are as safe, the
    comfortable one is better. Where every trajectory scores 0, the first one is the best: it brakes
    hardest.

    Areas and lanes are looked up every 0.2 s.

    Args:
        trajectories: (L, 40, 3) x, y, heading in the ego frame.
        state: (11,) state of the ego, world.
    """
    start = np.broadcast_to(state, (len(trajectories), ego.SIZE))
    poses = plan_to_poses(start[:, ego.POSE], trajectories.astype(np.float64))
    states = track(start, poses, WAYPOINTS, vehicle=vehicle)
    seen = states[:, ::STRIDE]
    corners = box_corners(seen[..., ego.POSE], vehicle)
    centres = box_centres(seen[..., ego.POSE], vehicle)
    areas = ego_areas(road.map, road.lanes, corners, centres, seen[..., ego.POSE])
    drivable = np.where(areas.non_drivable.any(axis=-1), 0.0, 1.0)
    direction = direction_compliance(centres, areas)
    safe, ttc = collisions(states, [_grown(obstacle) for obstacle in obstacles], vehicle)
    comfort = comfortable(trajectories, ego_status(DrivingCommand.UNKNOWN, state))
    begin, ends = road.middle.project(centres[0, 0]), road.middle.project(centres[:, -1])
    keeping = _lane_keeping(centres, areas.in_intersection, road.middle, begin, ends)
    metres = np.maximum(ends - begin, 0.0)
    allowed = safe * drivable * direction
    through = float((metres * allowed * keeping).max())
    room = through - _RESERVE if through > _BLOCKED else 0.0
    wanted = min(_wanted_metres(road, state), room)
    missed = np.abs(metres - wanted) / max(wanted, _LEAST_PROGRESS)
    progress = np.clip(1.0 - missed, 0.0, 1.0)
    weighted = 5 * ttc + 5 * progress + 2 * keeping + 2 * comfort
    scores = np.stack([safe, drivable, ttc, progress, direction, keeping])
    total = allowed * weighted / 14
    best = int(steady_best(trajectories[None], total[None], (safe * ttc)[None])[0])
    return TrajectoryTargets(np.rint(_FULL * scores).astype(np.uint8), total, best)


def touched(state: Array, obstacles: Sequence[TargetObstacle], vehicle: VehicleParameters) -> bool:
    """Whether the ego (11,) touches an obstacle now, the margins counted in."""
    here = box_centres(state[ego.POSE], vehicle)
    size = (vehicle.length, vehicle.width)
    return any(bool(bev_touching(here, size, o.poses[0], o.size)) for o in map(_grown, obstacles))


def _grown(obstacle: TargetObstacle) -> TargetObstacle:
    return replace(obstacle, size=obstacle.size[:2] + 2 * np.array([_ALONG, _ACROSS]))


def _wanted_metres(road: TargetRoad, state: Array) -> float:
    """What a calm driver covers within the trajectory: towards the wanted speeds."""
    place, speed, driven = float(road.middle.project(state)), float(state[ego.VX]), 0.0
    for _ in range(WAYPOINTS):
        goal = float(np.interp(place + driven, road.middle.progress, road.speeds))
        speed = max(0.0, speed + 0.1 * float(np.clip((goal - speed) / 0.8, -2.5, 1.6)))
        driven += 0.1 * speed
    return driven


def _lane_keeping(
    centres: Array,
    in_intersection: NDArray[np.bool_],
    middle: Centreline,
    begin: Array,
    ends: Array,
) -> Array:
    # The part beside which it all happens: the lookup's cost grows with the path.
    first, last = min(begin, ends.min()), max(begin, ends.max())
    part = middle.stretch(first - 10.0, last + 10.0, vertices_only=False)
    shapely.prepare(part)
    off = shapely.distance(part, shapely.points(centres[..., :2]))
    off = np.where(in_intersection, 0.0, off)
    left = (off > np.maximum(_LEAVES, off[:, :1] + 0.2)).any(axis=1)
    running = np.zeros(len(off), np.int64)
    longest = running.copy()
    for step in range(1, off.shape[1]):
        running = np.where(off[:, step] > _OFF_LANE, running + STRIDE, 0)
        longest = np.maximum(longest, running)
    return np.where((longest >= _OFF_LANE_STEPS) | left, 0.0, 1.0)


@dataclass(frozen=True)
class TargetObstacle:
    """A road user whose future is known.

    Attributes:
        token: id of the obstacle.
        poses: (FORESEEN + 1, 3) x, y, heading of its box centre from now on, world.
        size: (>=2,) length and width, metres.
    """

    token: str
    poses: Array
    size: Array


def collisions(
    states: Array, obstacles: Sequence[TargetObstacle], vehicle: VehicleParameters, dt: float = 0.1
) -> tuple[Array, Array]:
    """NC (P,), 0, 0.5 or 1, and TTC (P,), 0 or 1, of simulated states (P, 41, 11).

    Each obstacle counts by its first contact: by half where the ego stands, since it could have
    stopped earlier; not at all where it is hit from behind (more than 150 degrees off its heading);
    and ignored from then on. By half, too, what comes later to where the ego ends: if it stands
    there, or if it comes from ahead (less than 30 degrees off). For TTC the box is moved on at
    constant velocity by 0, 0.3, 0.6 and 0.9 s.
    """
    count, steps = states.shape[:2]
    safe, clear = np.ones(count), np.ones(count)
    poses = states[..., ego.POSE]
    speed = np.hypot(states[..., ego.VX], states[..., ego.VY])
    heading = poses[..., 2]
    way = np.stack([np.cos(heading), np.sin(heading)], axis=-1) * (dt * speed)[..., None]
    # (P, T, F, 3): boxes now and moved on.
    boxes = np.repeat(box_centres(poses, vehicle)[:, :, None], len(_LOOK_AHEAD), axis=2)
    boxes[..., :2] += _LOOK_AHEAD[:, None] * way[:, :, None]
    when = np.arange(steps)[:, None] + _LOOK_AHEAD  # (T, F)
    rows = np.arange(count)
    places = boxes.reshape(-1, 3)[:, :2].T.copy()  # reductions along long rows are fast
    low, high = places.min(axis=1), places.max(axis=1)
    for obstacle in obstacles:
        reach = (np.hypot(vehicle.length, vehicle.width) + np.hypot(*obstacle.size[:2])) / 2
        points = obstacle.poses[:, :2]
        if not ((points >= low - reach) & (points <= high + reach)).all(axis=-1).any():
            continue  # no box comes close to it
        size, there = (vehicle.length, vehicle.width), obstacle.poses[when]  # (T, F, 3)
        touching = bev_touching(boxes, size, there, obstacle.size)
        offset = there[..., :2] - poses[:, :, None, :2]
        bearing = np.abs(
            se2.wrap_angle(np.arctan2(offset[..., 1], offset[..., 0]) - heading[..., None])
        )
        now = touching[..., 0]
        first = now.argmax(axis=1)
        # The obstacle's speed now decides, as in PDM.
        standing = np.hypot(*(obstacle.poses[1, :2] - obstacle.poses[0, :2])) / dt <= _STOPPED
        met = now.any(axis=1) & (standing | (bearing[rows, first, 0] <= _BEHIND))
        of_first = np.where(speed[rows, first] > _STOPPED, 0.0, _RUN_INTO)
        safe[met] = np.minimum(safe[met], of_first[met])
        within = np.where(speed[:, -1] < _AS_GOOD_AS_STANDING, _BEHIND, _AHEAD)
        waits = np.flatnonzero(~now.any(axis=1) & (bearing[:, -1, 0] <= within))
        later = bev_touching(boxes[waits, -1:, 0], size, obstacle.poses[steps:], obstacle.size)
        blamed = waits[later.any(axis=1)]
        safe[blamed] = np.minimum(safe[blamed], _RUN_INTO)
        soon = (touching & (speed >= _STOPPED_TTC)[..., None]).reshape(count, -1)
        first = soon.argmax(axis=1)
        clear[soon.any(axis=1) & (bearing.reshape(count, -1)[rows, first] <= _BEHIND)] = 0.0
    return safe, clear


class Expert(BasePlanner):
    """The driver that the samples come from, as a planner: the best trajectory by its true scores.

    It is told where the boxes will be; those that react it foresees at constant velocity. With it,
    the measure of driving tells how good what is learnt can be.
    """

    name = "expert"
    needs_images = False
    foresees = True

    @property
    def record_fields(self) -> Mapping[str, str | float]:
        """That it is no planner to be tested."""
        return {"told": "where the others will be"}

    def __init__(self) -> None:
        self._road: TargetRoad | None = None

    def reset(self, context: PlanningContext) -> None:
        """Raises InputError: the log has no map."""
        if context.map is None:
            raise InputError("planner expert", "map", "is missing", "use a log with a map")
        self._road = target_road(context.route, context.map)

    def plan(self, observation: PlannerInput) -> Plan:
        """The best motion primitive."""
        assert self._road is not None
        obstacles = [
            TargetObstacle(one.track_id, _future(one), np.asarray(one.size, np.float64))
            for one in observation.actors
        ]
        state = np.asarray(observation.ego)
        possible = PRIMITIVES.trajectories(ego_status(observation.command, state)[None])[0]
        found = score_trajectories(possible, state, self._road, obstacles)
        return Plan(waypoints=possible[found.best].astype(np.float64))


def _future(actor: ActorState) -> Array:
    """Poses (FORESEEN + 1, 3) from now on; behind what is told, it goes on as it last moved."""
    told = actor.pose[None] if actor.future is None else actor.future[: FORESEEN + 1]
    step = _DT * np.array([*actor.velocity, 0.0])
    if len(told) > 1:
        step = np.array([*(told[-1] - told[-2])[:2], 0.0])
    later = np.arange(1, FORESEEN + 2 - len(told))[:, None]
    return np.concatenate([told, told[-1] + later * step])
