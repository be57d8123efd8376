"""Everything about a rollout that is fixed before the planner speaks: start, script, cuts."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from recast.dynamics import initial_state
from recast.dynamics import state as ego
from recast.errors import InputError
from recast.logs.checks import WORLD_REACH
from recast.logs.types import Track
from recast.planning import ReferenceRoute
from recast.simulation.lift import RoadSurface
from recast.simulation.motions import StartSituation
from recast.simulation.neighbour_lane import neighbour_lateral
from recast.simulation.rollout import PATH_COLUMNS, ego_centre
from recast.simulation.setup import RolloutSetup
from recast.simulation.start_checks import (
    refuse_off_map,
    refuse_off_road,
    refuse_overlap,
    surveyed_road,
)

Array = NDArray[np.float64]

_MIN_START_SPEED = 3.0
_MIN_CYCLES = 2
_BEHIND_START = 1.0
"""Metres that a position may lie before the route: a standing ego may roll back a little."""


@dataclass(frozen=True)
class PreparedRollout:
    """The start of a rollout and the actor's whole script; the same for every planner and method.

    Attributes:
        route, surface: the road.
        start_timestamp_us: log time of state 0.
        ego: (11,) initial ego state.
        log_ego: (S+1, 4) logged ego x, y, heading, speed.
        actor: (S+1, 4) x, y, heading of the box centre, speed.
        world_from_actor: (S+1, 4, 4).
        cut_reason: why S is less than asked for; None if it is not.
    """

    route: ReferenceRoute
    surface: RoadSurface
    start_timestamp_us: int
    ego: Array
    log_ego: Array
    actor: Array
    world_from_actor: Array
    cut_reason: str | None

    @property
    def steps(self) -> int:
        """Steps S that log and road allow to the actor; the ego may leave the road earlier."""
        return len(self.actor) - 1


def prepare(setup: RolloutSetup) -> PreparedRollout:
    """Find the start, script the actor, and cut what the recorded road does not carry.

    Raises:
        InputError: no such track; no route; a start outside the log; a route off the map; the actor
            overlaps the ego at the start, or stands off the recorded road or the map's; less than
            two plan cycles remain; the motion's script is not made of states.
    """
    track, log = setup.track, setup.log.world_from_rig
    route = ReferenceRoute.from_trajectory(log)
    hdmap = setup.hdmap
    surface = RoadSurface.from_log(log, route, None if hdmap is None else hdmap.ground)
    start_us = _start(setup)
    state = initial_state(log.timestamps_us, log.poses, start_us, setup.vehicle)

    recorded = int((log.timestamps_us[-1] - start_us) // round(setup.dt * 1e6))
    steps, reason = setup.steps, None
    if recorded < steps:
        steps = recorded
        reason = f"the log ends {recorded * setup.dt:.1f} s after the start"
    refuse_if_too_short(setup, steps, reason)

    situation = _situation(setup, route, state, track)
    where, rollout, road = setup.log.name, f"rollout {setup.name}", surveyed_road(hdmap)
    refuse_off_map(where, rollout, road, route, situation.ego_s)
    # In full first: a motion must not depend on where it is cut.
    actor = _script(setup, situation)
    outside = off_road(route, actor[:, :2], setup.road_margin)
    if np.any(outside[: steps + 1]):
        steps = int(np.argmax(outside)) - 1
        reason = _off_road_reason("the actor", route, actor[steps + 1, :2], setup)
        refuse_if_too_short(setup, steps, reason)
    actor = actor[: steps + 1]
    vehicle = setup.vehicle
    refuse_overlap(
        where,
        rollout,
        ego_centre(state[ego.POSE], vehicle.centre_offset),
        np.array([vehicle.length, vehicle.width]),
        actor[0, :3],
        track.size,
    )
    refuse_off_road(where, rollout, road, actor[0, :3], track.size)

    times = start_us + round(setup.dt * 1e6) * np.arange(steps + 1)
    logged = np.stack(
        [initial_state(log.timestamps_us, log.poses, int(t), setup.vehicle) for t in times]
    )
    return PreparedRollout(
        route=route,
        surface=surface,
        start_timestamp_us=start_us,
        ego=state,
        log_ego=logged[:, [ego.X, ego.Y, ego.HEADING, ego.VX]],
        actor=actor,
        world_from_actor=surface.actor_poses(actor[:, :3], track.size),
        cut_reason=reason,
    )


def _script(setup: RolloutSetup, situation: StartSituation) -> Array:
    """The actor's states (steps + 1, 4); motions may be the user's own."""
    actor = np.asarray(setup.motion.script(situation, setup.steps, setup.dt))
    expected, problem = (setup.steps + 1, len(PATH_COLUMNS)), None
    if actor.shape != expected or actor.dtype.kind not in "iuf":
        problem = f"its script is {actor.dtype} {actor.shape}, not numbers {expected}"
    elif not (np.abs(actor) <= WORLD_REACH).all():  # also NaN
        step = int(np.argmin((np.abs(actor) <= WORLD_REACH).all(axis=1)))
        problem = f"its state {step} is {actor[step].tolist()}"
    elif (actor[:, 3] < 0).any():
        problem = f"its speed is negative in state {int(np.argmax(actor[:, 3] < 0))}"
    if problem is not None:
        mend = "see docs/scenarios.md for what a motion's script is"
        raise InputError(setup.log.name, f"motion {setup.motion.name}", problem, mend)
    return actor.astype(np.float64)


def off_road(route: ReferenceRoute, points: Array, margin: float) -> NDArray[np.bool_]:
    """Which points (..., 2) lie before the recorded road, or beyond its end less `margin`."""
    s, _ = route.project(points)
    outside: NDArray[np.bool_] = (s < -_BEHIND_START) | (s > route.length - margin)
    return outside


def off_road_cut(setup: RolloutSetup, route: ReferenceRoute, point: Array) -> str:
    """The reason for cutting where the ego's rear axle would come to `point` (2,)."""
    return _off_road_reason("the ego", route, point, setup)


def refuse_if_too_short(setup: RolloutSetup, steps: int, reason: str | None) -> None:
    """Refuse a rollout of which a cut leaves less than two plan cycles.

    Raises:
        InputError: names the reason of the cut.
    """
    needed = min(_MIN_CYCLES * setup.plan_every, setup.steps)
    if steps < needed:
        raise InputError(
            setup.log.name,
            f"rollout {setup.name}",
            f"{reason}, which leaves {max(steps, 0)} of {setup.steps} steps "
            f"where at least {needed} are needed",
            "choose an earlier start, another motion or setting, or a longer log",
        )


def _off_road_reason(who: str, route: ReferenceRoute, point: Array, setup: RolloutSetup) -> str:
    s = float(route.project(point)[0])
    if s < 0:
        return f"{who} would leave the recorded road {-s:.1f} m before its start"
    return (
        f"{who} would leave the recorded road: it would be at {s:.1f} m of {route.length:.1f} m, "
        f"closer than {setup.road_margin:g} m to its end"
    )


def _start(setup: RolloutSetup) -> int:
    log = setup.log.world_from_rig
    first, last = int(log.timestamps_us[0]), int(log.timestamps_us[-1])
    if setup.start_timestamp_us is not None:
        if not first <= setup.start_timestamp_us <= last:
            raise InputError(
                setup.log.name,
                "start_timestamp_us",
                f"{setup.start_timestamp_us} lies outside the log",
                f"choose one within [{first}, {last}]",
            )
        return setup.start_timestamp_us
    latest = last - round(setup.steps * setup.dt * 1e6)
    for timestamp in log.timestamps_us[log.timestamps_us <= latest]:
        state = initial_state(log.timestamps_us, log.poses, int(timestamp), setup.vehicle)
        if state[ego.VX] >= _MIN_START_SPEED:
            return int(timestamp)
    return first


def _situation(
    setup: RolloutSetup, route: ReferenceRoute, state: Array, track: Track
) -> StartSituation:
    s = float(route.project(state)[0]) + setup.vehicle.centre_offset
    return StartSituation(
        route=route,
        ego_s=s,
        ego_speed=float(state[ego.VX]),
        ego_length=setup.vehicle.length,
        actor_size=track.size,
        neighbour_lateral=neighbour_lateral(setup.log, setup.hdmap, route, s),
    )
