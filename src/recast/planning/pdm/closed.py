"""PDM-Closed (Dauner et al. 2023): fifteen proposals, simulated and scored; the best one drives.

`PdmClosed` plans; `PdmClosedPlanner` is it on the planner seam.
"""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from dataclasses import dataclass

import numpy as np
import shapely
from numpy.typing import ArrayLike

from recast.arrays import Array
from recast.core.errors import InputError
from recast.dynamics import PACIFICA, VehicleParameters, track
from recast.dynamics import state as ego
from recast.geometry import se2
from recast.planning.map import PlannerLane, PlannerMap, continued_route, planner_map, route_blocks
from recast.planning.pdm.forecast import Forecast, Obstacle, box_centres, forecast, outline
from recast.planning.pdm.proposals import (
    DT,
    Centreline,
    PdmConfig,
    Unroll,
    brake_plan,
    brakes,
    repair_route,
    route_centreline,
    start_block,
    start_lane,
)
from recast.planning.pdm.scorer import Scores, score_proposals
from recast.planning.types import (
    WAYPOINTS,
    BasePlanner,
    Plan,
    PlannerInput,
    PlanningContext,
)

_LOOK_AHEAD = 10
"""Steps that the time to collision looks beyond a proposal."""
_TIE = 1e-9
_BEYOND = 120.0
"""Metres of route beyond the log's: 8 s at 15 m/s, so that its end is not braked for too early."""


@dataclass(frozen=True)
class PdmPlan:
    """One plan with everything that led to it.

    Attributes:
        trajectory: (81, 3) world poses of the rear axle from now on. They lie on the chosen path:
            the first one is the ego's projection onto it, unless `braked`.
        proposals: (15, 41, 3) world poses.
        simulated: (15, 41, 11) states that result from following them.
    """

    trajectory: Array
    best: int
    braked: bool
    unroll: Unroll
    proposals: Array
    simulated: Array
    scores: Scores


class PdmClosed:
    """The planner for one drive; the centreline found at the first call stays.

    Args:
        route: block ids in order, mended at the first call.
        vehicle: the ego.

    Raises:
        InputError: the map has no lanes, or the route is empty or names blocks it lacks.
    """

    def __init__(
        self,
        planner_map: PlannerMap,
        route: Sequence[str],
        vehicle: VehicleParameters = PACIFICA,
        config: PdmConfig | None = None,
    ) -> None:
        if not planner_map.lanes:
            raise InputError(
                "map", "lanes", "are missing", "use a map with lanes: PDM-Closed needs them"
            )
        unknown = [block for block in route if block not in planner_map.blocks]
        if unknown or not route:
            problem = f"the map lacks block {unknown[0]!r}" if unknown else "is empty"
            raise InputError("route", "blocks", problem, "use a route on this map")
        self.config = config or PdmConfig()
        self._map, self._vehicle = planner_map, vehicle
        self._route, self._route_lanes = list(route), planner_map.lanes_of(route)
        self._paths: list[Centreline] = []
        self._collided: set[str] = set()

    @property
    def centreline(self) -> Centreline:
        """The path along the route; available after the first plan."""
        return self._paths[0]

    @property
    def route(self) -> tuple[str, ...]:
        """Block ids in order."""
        return tuple(self._route)

    def plan(
        self, state: ArrayLike, obstacles: Iterable[Obstacle], red_lanes: Iterable[str] = ()
    ) -> PdmPlan:
        """Plan 8 s from an ego state (11,).

        Args:
            obstacles: the other road users and objects now.
            red_lanes: ids of connectors closed by a red light.

        Raises:
            InputError: at the first call, the ego is more than the radius away from the route.
        """
        state, config = np.asarray(state, np.float64), self.config
        lane = self._lane(state)
        if not self._paths:
            self._start(state, lane)
            lane = self._lane(state)
        seen = self._forecast(state, obstacles, red_lanes)
        limit = lane.speed_limit or config.default_speed_limit
        targets = np.array(config.speed_fractions) * limit
        unroll = Unroll(self._paths, targets, seen, state, self._vehicle, config)
        count = len(self._paths) * len(targets)
        proposals = unroll.poses(range(count), config.proposal_steps)
        simulated = track(
            np.broadcast_to(state, (count, ego.SIZE)),
            proposals,
            config.proposal_steps,
            config.tracker,
            self._vehicle,
            DT,
        )
        scores = score_proposals(
            simulated,
            seen,
            self.centreline,
            self._around(state),
            self._route_lanes,
            self._vehicle,
            DT,
            reference_quirks=config.reference_quirks,
        )
        best = self._best(scores.total, state)
        speed = float(np.hypot(state[ego.VX], state[ego.VY]))
        braked = brakes(speed, float(scores.collision_step[best]) * DT)
        if braked:
            trajectory = brake_plan(
                state, config.plan_steps, DT, reference_quirks=config.reference_quirks
            )
        else:
            unroll.extend(best)
            trajectory = unroll.poses([best], config.plan_steps)[0]
        return PdmPlan(trajectory, best, braked, unroll, proposals, simulated, scores)

    def _start(self, state: Array, lane: PlannerLane) -> None:
        """Mend the route and fix the paths."""
        shape = outline(state[ego.POSE], self._vehicle)
        if not lane.polygon.dwithin(shape, self.config.radius):
            raise InputError(
                "route",
                "ego",
                f"({state[ego.X]:.1f}, {state[ego.Y]:.1f}) is {lane.polygon.distance(shape):.0f} m "
                "away from the nearest lane of the route",
                "start on the mapped road",
            )
        here = start_block(self._map, state[ego.POSE], self._route)
        self._route = repair_route(self._map, self._route, here)
        self._route_lanes = self._map.lanes_of(self._route)
        centreline = route_centreline(self._map, self._route, self._lane(state))
        offsets = self.config.lateral_offsets
        self._paths = [centreline, *(centreline.shifted(offset) for offset in offsets)]

    def _lane(self, state: Array) -> PlannerLane:
        pose = state[ego.POSE]
        shape = outline(pose, self._vehicle)
        centre = box_centres(pose, self._vehicle)
        return start_lane(self._map, self._route_lanes, pose, centre, shape)

    def _forecast(
        self, state: Array, obstacles: Iterable[Obstacle], red_lanes: Iterable[str]
    ) -> Forecast:
        config, pose = self.config, state[ego.POSE]
        on_route = set(self._route_lanes)
        red = [(key, self._map.lanes[key].polygon) for key in red_lanes if key in on_route]
        return forecast(
            obstacles,
            red,
            box_centres(pose, self._vehicle),
            outline(pose, self._vehicle),
            self._collided,
            steps=max(config.proposal_steps + _LOOK_AHEAD, config.plan_steps),
            dt=DT,
            radius=config.radius,
        )

    def _around(self, state: Array) -> PlannerMap:
        if not self.config.reference_quirks:
            return self._map
        centre = box_centres(state[ego.POSE], self._vehicle)
        return self._map.near(centre, self.config.radius)

    def _best(self, total: Array, state: Array) -> int:
        if self.config.reference_quirks:
            return int(np.argmax(total))
        equal = np.flatnonzero(total >= total.max() - _TIE)
        here = shapely.Point(*state[: ego.HEADING])
        distance = [path.line.distance(here) for path in self._paths]
        per_path = len(self.config.speed_fractions)
        return int(min(equal, key=lambda i: (round(distance[i // per_path], 9), i)))


class PdmClosedPlanner(BasePlanner):
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
                "the log has no map",
                "use a log with a map, or derive a map from the drive",
            )
        self._times = np.asarray(context.dt * np.arange(1, WAYPOINTS + 1), np.float64)
        planned = DT * self.config.plan_steps
        if self._times[-1] > planned + 1e-9:
            raise InputError(
                "planner pdm-closed",
                "dt",
                f"is {context.dt:g} s: {WAYPOINTS} waypoints exceed its plan of {planned:g} s",
                f"simulate with dt {planned / WAYPOINTS:g} or less",
            )
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
