"""Simple planners: straight ahead, the log's own drive, probes of frames, and an IDM lane follower.

The motion of probes is known in advance. Each can be named, as
`recast.planning.simple:left_arc`. `recast.simulation.probe_path` drives any planner over an empty
plane and says where it went.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from functools import partial

import numpy as np
from numpy.typing import ArrayLike, NDArray

from recast.arrays import Array
from recast.dynamics import IdmParameters, idm_acceleration, initial_state
from recast.dynamics import state as ego
from recast.dynamics.state import NUPLAN_PLANNER
from recast.geometry import boxes, se2
from recast.planning.types import (
    WAYPOINTS,
    ActorState,
    BasePlanner,
    Plan,
    PlannerInput,
    PlanningContext,
    ReferenceRoute,
    route_lanes,
)


class _Blind(BasePlanner):
    """Knows the times of its waypoints, and sees nothing."""

    needs_images = False

    def __init__(self) -> None:
        self._times = 0.1 * np.arange(1, WAYPOINTS + 1)

    def reset(self, context: PlanningContext) -> None:
        """Take the time step."""
        self._times = context.dt * np.arange(1, WAYPOINTS + 1)


class ConstantVelocity(_Blind):
    """Keeps heading and speed; sees nothing."""

    name = "constant-velocity"

    def plan(self, observation: PlannerInput) -> Plan:
        """Waypoints on the ego's x axis."""
        waypoints = np.zeros((WAYPOINTS, 3))
        waypoints[:, 0] = max(float(observation.ego[ego.VX]), 0.0) * self._times
        return Plan(waypoints)


class LogReplay(BasePlanner):
    """Waypoints are the logged poses of the coming 4 s.

    A rollout puts the ego onto the log's states, without a tracker: the replay is the log itself.
    Where the log ends within the 4 s, the plan goes on straight at the last logged speed; its
    `info` says how many waypoints that concerns.
    """

    name = "log-replay"
    needs_images = False
    replays_log = True

    def __init__(self) -> None:
        self._context: PlanningContext | None = None

    def reset(self, context: PlanningContext) -> None:
        """Take the logged trajectory."""
        self._context = context

    def plan(self, observation: PlannerInput) -> Plan:
        """The logged poses, seen from where the ego is now.

        Raises:
            RuntimeError: `reset` was not called.
        """
        if self._context is None:
            raise RuntimeError("LogReplay.plan: call reset first")
        log, dt = self._context.log, self._context.dt
        step_us = round(dt * 1e6)
        times = observation.timestamp_us + step_us * np.arange(1, WAYPOINTS + 1, dtype=np.int64)
        end = int(log.timestamps_us[-1])
        poses = se2.from_se3(log.at(np.minimum(times, end)))
        beyond = times > end
        if np.any(beyond):
            last = initial_state(log.timestamps_us, log.poses, end, self._context.vehicle, dt)
            distance = last[ego.VX] * (times[beyond] - end) * 1e-6
            ahead = np.stack([distance, np.zeros_like(distance), np.zeros_like(distance)], axis=-1)
            poses[beyond] = se2.compose(last[ego.POSE], ahead)
        return Plan(
            se2.relative(observation.ego[ego.POSE], poses),
            {"waypoints_beyond_log": float(np.count_nonzero(beyond))},
        )


PROBE_CURVATURES: Mapping[str, float] = {"straight": 0.0, "left-arc": 0.02, "right-arc": -0.02}
"""Curvature in 1/m by probe: positive turns left, y and heading grow."""


def arc(curvature: float, distance: ArrayLike) -> NDArray[np.float64]:
    """Poses (N, 3) on a circle through the origin at distances (N,) along it, in metres."""
    s = np.asarray(distance, np.float64)
    turn = curvature * s
    chord = s * np.sinc(turn / (2 * np.pi))
    return np.stack([chord * np.cos(turn / 2), chord * np.sin(turn / 2), turn], axis=-1)


class ProbePlanner(_Blind):
    """Drives an arc at its present speed, behind the simulator's own seam.

    Args:
        name: one of `PROBE_CURVATURES`.
    """

    def __init__(self, name: str) -> None:
        super().__init__()
        self.name = name
        self._curvature = PROBE_CURVATURES[name]

    def plan(self, observation: PlannerInput) -> Plan:
        """The arc for the coming 4 s."""
        return Plan(arc(self._curvature, float(observation.ego[ego.VX]) * self._times))


straight = partial(ProbePlanner, "straight")
left_arc = partial(ProbePlanner, "left-arc")
right_arc = partial(ProbePlanner, "right-arc")


_MOVING = 0.5
"""Speed in m/s from which a vehicle in the next lane may be about to change lanes."""
_APPROACH_RESPONSE = 0.2
"""Seconds in which too high an approach speed is braked off."""


@dataclass(frozen=True)
class IdmFollowerConfig:
    """Settings of `IdmLaneFollower`.

    Attributes:
        emergency_deceleration: m/s^2, used where comfortable braking would not avoid the lead.
        response_time: seconds by which the vehicle is taken to lag behind the plan when it is
            judged whether comfortable braking suffices.
        max_jerk: m/s^3 within a plan; its first acceleration is free, so that braking is not late.
        min_target_speed: m/s; without a speed limit the logged speed is the target, but never less
            than this, so that a halt in the log does not hold the ego for ever.
        corridor_margin: metres added to the ego's width on each side.
        lookahead: seconds for which a road user is watched to see if it enters the corridor.
        approach_speed: m/s by which the ego is faster at most when it comes up, within the headway,
            to a moving vehicle in the next lane; faster, and nothing could be done if it cut in.
        next_lane: metres beyond the corridor in which a vehicle counts as in the next lane.
        return_time: seconds to come back to the route, at the present speed.
    """

    idm: IdmParameters = NUPLAN_PLANNER
    emergency_deceleration: float = 7.0
    response_time: float = 0.4
    max_jerk: float = 8.0
    min_target_speed: float = 3.0
    corridor_margin: float = 0.3
    lookahead: float = 1.5
    approach_speed: float = 1.0
    next_lane: float = 2.5
    return_time: float = 3.0


@dataclass(frozen=True)
class _Lead:
    """A road user on the path, at the 40 steps of the plan."""

    track_id: str
    near_end: Array  # (40,) progress of its nearest point, metres from the ego's rear axle
    inside: NDArray[np.bool_]  # (40,) it is in the corridor then, will be soon, or has been
    speed: float  # along the route, m/s; negative when it comes towards the ego
    reserve: float  # metres of the gap that an oncoming one needs to stop


class IdmLaneFollower(BasePlanner):
    """State-conditioned: reads boxes and velocities, predicts them at constant velocity.

    The path is the reference route with a quintic return to it; the speed follows the intelligent
    driver model behind the most restrictive road user in the corridor. Where the deceleration
    needed to stay clear exceeds the comfortable one, that deceleration is applied, as far as the
    emergency limit allows. It drives forwards only: where the log backed up it stops.
    """

    name = "idm-follower"
    needs_images = False

    def __init__(self, config: IdmFollowerConfig | None = None) -> None:
        self.config = config or IdmFollowerConfig()
        self._context: PlanningContext | None = None
        self._limits: tuple[tuple[float, float, float], ...] = ()

    def reset(self, context: PlanningContext) -> None:
        """Read the speed limits along the route."""
        self._context = context
        limits = []
        for lane in () if context.map is None else route_lanes(context.map, context.route):
            if lane.speed_limit is not None:
                s, _ = context.route.project(lane.centreline)
                limits.append((float(s.min()), float(s.max()), lane.speed_limit))
        self._limits = tuple(limits)

    def plan(self, observation: PlannerInput) -> Plan:
        """Unroll the IDM for 4 s.

        Raises:
            RuntimeError: `reset` was not called.
        """
        if self._context is None:
            raise RuntimeError("IdmLaneFollower.plan: call reset first")
        context, state = self._context, observation.ego
        speed = max(float(state[ego.VX]), 0.0)
        path = _ReturnPath.from_pose(
            context.route,
            state[ego.POSE],
            max(8.0, self.config.return_time * speed),
            observation.route_s,
        )
        facing = float(se2.wrap_angle(state[ego.HEADING] - context.route.heading(path.start)))
        if abs(facing) > np.pi / 2:
            return self._halt(speed, context.dt)
        leads = [
            lead
            for actor in observation.actors
            if (lead := self._watch(actor, path, context)) is not None
        ]
        progress, followed, hardest = self._unroll(speed, path, leads, context)
        waypoints = se2.relative(state[ego.POSE], path.poses(progress))
        return Plan(waypoints, {"lead": followed, "hardest_acceleration": hardest})

    def _halt(self, speed: float, dt: float) -> Plan:
        """Brake to a stop straight ahead: the log reversed here, which this planner cannot."""
        braking = self.config.idm.max_deceleration
        times = np.minimum(dt * np.arange(1, WAYPOINTS + 1), speed / braking)
        waypoints = np.zeros((WAYPOINTS, 3))
        waypoints[:, 0] = speed * times - braking * times**2 / 2
        return Plan(waypoints, {"lead": "reversing", "hardest_acceleration": -braking})

    def _unroll(
        self, speed: float, path: _ReturnPath, leads: list[_Lead], context: PlanningContext
    ) -> tuple[Array, str, float]:
        """Progress (40,) along the path, the lead that decided most, the least acceleration."""
        progress = np.zeros(WAYPOINTS)
        position, previous, followed, hardest = 0.0, 0.0, "", np.inf
        ahead = path.route.cusps[path.route.cusps > path.start]
        cusp = float(ahead[0]) if len(ahead) else None
        braking: dict[str, float] = {}  # emergency deceleration by lead, held until it is over
        for j in range(WAYPOINTS):
            target = self._target_speed(path.start + position)
            acceleration = float(idm_acceleration(speed, target, np.inf, 0.0, self.config.idm))
            who = ""
            if cusp is not None:
                gap = cusp - path.start - position
                stop = float(idm_acceleration(speed, target, gap, 0.0, self.config.idm))
                if stop < acceleration:
                    acceleration, who = stop, "reversing"
            for lead in leads:
                bumper = position + context.vehicle.front_length
                behind = self._behind(lead, j, speed, target, bumper, braking)
                if behind < acceleration:
                    acceleration, who = behind, lead.track_id
            if j > 0:
                step = self.config.max_jerk * context.dt
                acceleration = float(np.clip(acceleration, previous - step, previous + step))
            # With this deceleration the jerk limit still brings the ego to a halt, not beyond.
            acceleration = max(acceleration, -np.sqrt(2 * self.config.max_jerk * speed))
            previous = acceleration
            if acceleration < hardest:
                hardest, followed = acceleration, who
            position += speed * context.dt
            speed = max(speed + acceleration * context.dt, 0.0)
            progress[j] = position
        return progress, followed, hardest

    def _behind(
        self,
        lead: _Lead,
        step: int,
        speed: float,
        target: float,
        bumper: float,
        braking: dict[str, float],
    ) -> float:
        """Acceleration in m/s^2 that one lead allows; keeps emergency braking in `braking`."""
        config, idm = self.config, self.config.idm
        closing = speed - lead.speed
        gap = lead.near_end[step] - bumper - lead.reserve
        if not lead.inside[step]:
            if not 0.0 < gap < idm.headway * speed:
                return np.inf
            excess = closing - config.approach_speed
            return -min(excess / _APPROACH_RESPONSE, idm.max_deceleration)
        lag = max(closing, 0.0) * config.response_time
        needed = _needed_deceleration(speed, lead.speed, gap - idm.min_gap - lag)
        if needed > idm.max_deceleration:
            needed = min(needed, config.emergency_deceleration)
            braking[lead.track_id] = max(needed, braking.get(lead.track_id, 0.0))
        if lead.track_id in braking and closing > 0.0:
            return -braking[lead.track_id]
        return float(idm_acceleration(speed, target, gap, lead.speed, idm))

    def _target_speed(self, s: float) -> float:
        limits = [limit for start, end, limit in self._limits if start <= s <= end]
        if limits:
            return min(limits)
        assert self._context is not None  # plan() has checked
        return max(float(self._context.route.logged_speed(s)), self.config.min_target_speed)

    def _watch(
        self, actor: ActorState, path: _ReturnPath, context: PlanningContext
    ) -> _Lead | None:
        """The actor as a lead, or None where it is behind or never comes near the corridor."""
        centre = float(path.route.project(actor.pose)[0])
        if centre - path.start < context.vehicle.centre_offset:
            return None  # beside or behind: keeping clear is up to the one behind
        heading = float(path.route.heading(centre))
        along, across = se2.relative([0.0, 0.0, heading], [*actor.velocity, 0.0])[:2]
        # Constant velocity in route coordinates, so that a lead in a bend stays on its lane.
        watched = round(self.config.lookahead / context.dt)
        times = context.dt * np.arange(WAYPOINTS + watched)[:, None]
        s, lateral = path.route.project(boxes.bev_corners(actor.pose, *actor.size[:2]))
        progress = s - path.start + along * times  # (T, 4 corners)
        offset = lateral + across * times - path.lateral(progress)
        half = context.vehicle.width / 2 + self.config.corridor_margin
        touching = (offset.min(axis=1) <= half) & (offset.max(axis=1) >= -half)
        soon = np.array([touching[j : j + watched + 1].any() for j in range(WAYPOINTS)])
        # At constant velocity a cut-in would slide out on the other side: it is taken to stay.
        inside = np.logical_or.accumulate(soon)
        near = np.abs(offset[0]).min() <= half + self.config.next_lane
        if not inside[-1] and not (near and along > _MOVING):
            return None
        idm = self.config.idm
        reserve = along**2 / (2 * idm.max_deceleration) - along * idm.headway if along < 0 else 0.0
        return _Lead(
            actor.track_id, progress.min(axis=1)[:WAYPOINTS], inside, float(along), float(reserve)
        )


@dataclass(frozen=True)
class _ReturnPath:
    """The route from the ego's pose on, with a lateral offset that fades out.

    The offset is a quintic over `distance` that starts with the ego's offset and slope and ends at
    zero with zero slope and curvature.
    """

    route: ReferenceRoute
    start: float
    offset: float
    slope: float
    distance: float

    @classmethod
    def from_pose(
        cls, route: ReferenceRoute, pose: Array, distance: float, near: float | None
    ) -> _ReturnPath:
        s, lateral = (float(value) for value in route.project(pose, near))
        turn = float(se2.wrap_angle(pose[2] - route.heading(s)))
        return cls(route, s, lateral, float(np.tan(np.clip(turn, -1.0, 1.0))), distance)

    def lateral(self, progress: Array) -> Array:
        """Offset from the route (...) at progress (...) metres beyond the start."""
        u = np.clip(progress / self.distance, 0.0, 1.0)
        fade = 1 - u**3 * (10 - 15 * u + 6 * u**2)
        lean = u - u**3 * (6 - 8 * u + 3 * u**2)
        return self.offset * fade + self.slope * self.distance * lean

    def poses(self, progress: Array) -> Array:
        """World poses (..., 3) of the rear axle at progress (...)."""
        u = np.clip(progress / self.distance, 0.0, 1.0)
        fade_rate = -(u**2) * (30 - 60 * u + 30 * u**2) / self.distance
        lean_rate = 1 - u**2 * (18 - 32 * u + 15 * u**2)
        slope = self.offset * fade_rate + self.slope * lean_rate
        poses = self.route.pose(self.start + progress, self.lateral(progress))
        poses[..., 2] = se2.wrap_angle(poses[..., 2] + np.arctan(slope))
        return poses


def _needed_deceleration(speed: float, lead_speed: float, gap: float) -> float:
    """Constant deceleration in m/s^2 that just stays clear of a lead at constant speed.

    Behind a lead that drives on: (v - v_lead)^2 / (2 gap). Towards one that comes closer, the ego
    must stand before they meet: (v^2 / 2 + v |v_lead|) / gap.
    """
    if speed <= max(lead_speed, 0.0):
        return 0.0
    gap = max(gap, 0.1)
    if lead_speed >= 0.0:
        return (speed - lead_speed) ** 2 / (2 * gap)
    return (speed**2 / 2 - speed * lead_speed) / gap
