"""Vehicles that follow their lanes by nuPlan's IDM and react to the ego: NAVSIM's traffic."""

from __future__ import annotations

from collections.abc import Collection, Sequence
from dataclasses import dataclass, field

import numpy as np
import shapely
from numpy.typing import ArrayLike

from recast.arrays import Array
from recast.dynamics import PACIFICA, IdmParameters, VehicleParameters, idm_step
from recast.dynamics import state as ego
from recast.geometry import boxes, se2
from recast.planning.map import PlannerLane, PlannerMap
from recast.planning.pdm import AgentKind, Centreline, Obstacle
from recast.planning.pdm.forecast import outline
from recast.planning.pdm.proposals import heading_error

_IDM = IdmParameters(min_gap=1.0, headway=1.5, max_acceleration=1.0, max_deceleration=2.0)
_TARGET = 10.0
"""m/s where a lane has no speed limit."""
_SNAP = 3.0
"""Metres from the centreline within which a vehicle follows it."""
_STANDING = 0.1
"""m/s below which a vehicle beside the lanes is parked."""
_PATH = 20.0
"""Metres of path that an agent has ahead at least, beside its headway."""
_RADIUS = 100.0
"""Metres from the ego beyond which agents are given up."""
_LANES = 12
"""Lanes of an agent's path at most: far more than it drives within 4 s."""
_DT = 0.1


@dataclass
class _Agent:
    """A vehicle on its lane."""

    size: Array
    path: Centreline  # path along its lane and the lanes that follow straightest
    # ends, limits: progress at which each lane ends, and its target speed.
    ends: Array
    limits: Array
    state: Array  # progress of its centre and speed
    lanes: int = 1  # how many of them it has taken up so far

    @property
    def pose(self) -> Array:
        """(3,) of its box centre."""
        return self.path.at(self.state[0])

    def box(self) -> shapely.Polygon:
        """Its outline."""
        return shapely.Polygon(boxes.bev_corners(self.pose, *self.size))

    def footprint(self) -> shapely.Geometry:
        """Its outline, and the path that it covers within its headway."""
        length, _ = self.size
        reach = length / 2 + self.state[1] * _IDM.headway
        return shapely.union(
            self.box(), self._strip(self.state[0] - length / 2, reach + length / 2)
        )

    def corridor(self) -> shapely.Geometry:
        """The rest of the path that it has taken up, as wide as itself."""
        return self._strip(self.state[0], self.ends[self.lanes - 1] - self.state[0])

    def extend(self) -> None:
        """Take up lanes until the path ahead is long enough."""
        while self.lanes < len(self.ends):
            ahead = self.ends[self.lanes - 1] - self.state[0]
            if ahead >= _PATH + self.limits[self.lanes - 1] * _IDM.headway:
                return
            self.lanes += 1

    def advance(self, gap: float, lead_speed: float) -> None:
        """Drive for a step behind a lead at a gap in metres."""
        target = self.limits[self.lanes - 1]
        self.state = idm_step(self.state, [self.state[0] + gap, lead_speed, 0.0], target, _IDM, _DT)
        self.state[1] = max(self.state[1], 0.0)
        self.state[0] = min(self.state[0], self.ends[self.lanes - 1])

    def _strip(self, start: float, metres: float) -> shapely.Geometry:
        part = self.path.stretch(start, start + metres, vertices_only=False)
        return shapely.buffer(part, self.size[1] / 2, cap_style="flat")


@dataclass(frozen=True)
class IdmTraffic:
    """Where road users go for a driven ego: a `Traffic` of `Situation`.

    As in NAVSIM: a vehicle within 3 m of a lane's centreline is put onto it and follows it and the
    straightest lanes after it, by nuPlan's IDM (speed limit, else 10 m/s; 1 m and 1.5 s; 1 and 2
    m/s^2). Its lead is the nearest of what meets its path: the ego, other vehicles with the path
    within their headways, and the rest; with none, the end of its path. Vehicles that stand beside
    the lanes, or further from a centreline, stay; vehicles that would overlap are left out. All
    others go as given. What stop lines would do is done by ending paths before red connectors.

    Attributes:
        obstacles: n road users and objects now.
        others: (n, 41, 3) poses of those that are no vehicles; vehicles' are not read.
        red: ids of connectors whose light is red.
    """

    planner_map: PlannerMap
    obstacles: Sequence[Obstacle]
    others: ArrayLike
    vehicle: VehicleParameters = PACIFICA
    red: Collection[str] = field(default=())

    def __call__(self, states: Array) -> Array:
        """Poses (n, T, 3) for the ego's states (T, 11); NaN for what is left out."""
        given = np.asarray(self.others, np.float64)
        poses = np.full((len(self.obstacles), len(states), 3), np.nan)
        egos = [outline(state[ego.POSE], self.vehicle) for state in states]
        agents = self._agents(egos[0])
        taken = [agent.box() for agent in agents.values()]
        for i, one in enumerate(self.obstacles):
            if one.kind is not AgentKind.VEHICLE:
                poses[i] = given[i]
            elif i not in agents and self._stays(one, taken):
                poses[i] = one.pose
        shapes = {i: agent.box() for i, agent in agents.items()}
        for step, state in enumerate(states):
            for i, agent in list(agents.items()):
                if np.hypot(*(agent.pose[:2] - state[:2])) > _RADIUS:
                    del agents[i], shapes[i]
                    continue
                poses[i, step] = agent.pose
            present = {i: p[step] for i, p in enumerate(poses) if i not in agents}
            fixed = {
                i: shapely.Polygon(boxes.bev_corners(pose, *self.obstacles[i].size[:2]))
                for i, pose in present.items()
                if not np.isnan(pose).any()
            }
            speed = float(np.hypot(state[ego.VX], state[ego.VY]))
            for i, agent in agents.items():
                agent.extend()
                _follow(
                    i, agent, agents, shapes, fixed, egos[step], speed, float(state[ego.HEADING])
                )
                shapes[i] = agent.footprint()
        return poses

    def _agents(self, ego_box: shapely.Polygon) -> dict[int, _Agent]:
        """By index, the vehicles that follow lanes."""
        found: dict[int, _Agent] = {}
        taken = [ego_box]
        for i, one in enumerate(self.obstacles):
            lane = self._lane(one) if one.kind is AgentKind.VEHICLE else None
            if lane is None or _aside(lane, one) > _SNAP:
                continue
            agent = self._agent(one, lane)
            if shapely.intersects(agent.box(), taken).any():
                continue
            taken.append(agent.box())
            found[i] = agent
        return found

    def _agent(self, one: Obstacle, lane: PlannerLane) -> _Agent:
        chain = [lane]
        while len(chain) < _LANES:
            after = [self.planner_map.lanes[key] for key in chain[-1].successors]
            after = [other for other in after if other.lane_id not in self.red]
            if not after:
                break
            chain.append(min(after, key=_bend))
        path = Centreline(np.concatenate([other.centreline for other in chain]))
        last = np.cumsum([len(other.centreline) for other in chain]) - 1
        limits = np.array([other.speed_limit or _TARGET for other in chain])
        progress = float(Centreline(lane.centreline).project(one.pose))
        state = np.array([progress, float(np.hypot(*one.velocity))])
        return _Agent(one.size[:2], path, path.progress[last], limits, state)

    def _lane(self, one: Obstacle) -> PlannerLane | None:
        """The lane under a box's centre, else the connector; of several the best by heading."""
        under = [self.planner_map.lanes[key] for key in self.planner_map.lanes_at(one.pose)]
        under = [lane for lane in under if not lane.connector] or under
        return min(under, key=lambda lane: heading_error(lane, one.pose), default=None)

    def _stays(self, one: Obstacle, taken: list[shapely.Polygon]) -> bool:
        """Whether a vehicle that follows no lane is there at all."""
        lane = self._lane(one)
        parked = lane is None and float(np.hypot(*one.velocity)) < _STANDING
        if not (parked or (lane is not None and _aside(lane, one) > _SNAP)):
            return False
        box = shapely.Polygon(boxes.bev_corners(one.pose, *one.size[:2]))
        return not (len(taken) and bool(shapely.intersects(box, taken).any()))


def _follow(
    own: int,
    agent: _Agent,
    agents: dict[int, _Agent],
    shapes: dict[int, shapely.Geometry],
    fixed: dict[int, shapely.Geometry],
    ego_box: shapely.Polygon,
    ego_speed: float,
    ego_heading: float,
) -> None:
    """Drive an agent for a step behind the nearest of what meets its path."""
    corridor, heading = agent.corridor(), agent.pose[2]
    others = [(shapes[i], agents[i].state[1], agents[i].pose[2]) for i in shapes if i != own]
    others += [(shape, 0.0, 0.0) for shape in fixed.values()]
    others.append((ego_box, ego_speed, ego_heading))
    met = [one for one in others if corridor.intersects(one[0])]
    if not met:
        agent.advance(agent.ends[agent.lanes - 1] - agent.state[0] - agent.size[0] / 2, 0.0)
        return
    gaps = [shapes[own].distance(shape) for shape, _, _ in met]
    nearest = int(np.argmin(gaps))
    _, speed, course = met[nearest]
    agent.advance(gaps[nearest], speed * float(np.cos(se2.wrap_angle(course - heading))))


def _aside(lane: PlannerLane, one: Obstacle) -> float:
    """Metres from a box's centre to a lane's centreline."""
    return float(Centreline(lane.centreline).line.distance(shapely.Point(*one.pose[:2])))


def _bend(lane: PlannerLane) -> float:
    """Radians, not negative, by which the lane turns at its beginning."""
    return abs(float(se2.wrap_angle(lane.centreline[1, 2] - lane.centreline[0, 2])))
