"""What a simulator has done: the world at a step, the ego's past, and all of it as a `Rollout`."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace

import numpy as np

from recast.arrays import Array
from recast.core.foreign import read_only
from recast.dynamics import EgoState, initial_state
from recast.dynamics import state as ego
from recast.planning import WAYPOINTS
from recast.simulation.actors import ControlledActors, other_ids, other_poses
from recast.simulation.renderer import SensorRenderer
from recast.simulation.rollout import Rollout
from recast.simulation.rollout_start import RolloutStart
from recast.simulation.setup import RolloutSetup
from recast.simulation.state import ControlledActor, RolloutOrigin, SimActor, SimState

_HISTORY = 2.0
"""Seconds of past states that a planner is shown."""


def timestamp_us(setup: RolloutSetup, start: RolloutStart, step: int) -> int:
    """Log time of a step."""
    return start.start_timestamp_us + step * round(setup.dt * 1e6)


def sim_state(
    setup: RolloutSetup, start: RolloutStart, actors: ControlledActors, now: Array, step: int
) -> SimState:
    """The world at a step.

    Args:
        now: (11,) state of the ego at that step.
    """
    time = timestamp_us(setup, start, step)
    controlled = {}
    for track_id in setup.controlled:
        logged = setup.track_of(track_id).trajectory
        controlled[track_id] = SimActor(
            state=actors.state(track_id, step),
            world_from_actor=actors.pose(track_id, step),
            log_world_from_actor=logged.at(time) if logged.covers(time) else None,
        )
    target = controlled.pop(setup.track_id)
    return SimState(
        step=step,
        timestamp_us=time,
        ego=EgoState(now),
        log_ego=start.ego[step, [ego.X, ego.Y, ego.HEADING, ego.VX]],
        world_from_rig=start.surface.ego_poses(now[ego.POSE]),
        track_id=setup.track_id,
        actor=target.state,
        world_from_actor=target.world_from_actor,
        log_world_from_actor=target.log_world_from_actor,
        others=other_poses(setup, time),
        further=controlled,
    )


def history_steps(setup: RolloutSetup) -> int:
    """Past states that a planner is shown, besides the present one."""
    return round(_HISTORY / setup.dt)


def logged_past(setup: RolloutSetup, start: RolloutStart) -> list[Array]:
    """Ego states (11,) before the start, as many as recorded, oldest first.

    They are the logged ones, moved as the start is (`RolloutSetup.start_left`).
    """
    log, step = setup.log.world_from_rig, round(setup.dt * 1e6)
    first = start.start_timestamp_us
    count = min(history_steps(setup), int((first - log.timestamps_us[0]) // step))
    times = [first - step * i for i in range(count, 0, -1)]
    past = [initial_state(log.timestamps_us, log.poses, time, setup.vehicle) for time in times]
    left = setup.start_left
    return [ego.moved_left(state, left) for state in past] if left else past


def make_rollout(
    *,
    setup: RolloutSetup,
    start: RolloutStart,
    actors: ControlledActors,
    planner: str,
    ego_states: Array,
    predictions: Sequence[Array],
    plan_steps: Sequence[int],
    cut_reason: str | None,
    renderer: SensorRenderer | None,
) -> Rollout:
    """A rollout of the states that were reached, validated and read-only.

    Args:
        ego_states: (S+1, 11) states of the simulated ego.
        predictions: (40, 3) waypoints of each plan.
        plan_steps: step at which each plan was made.

    Raises:
        ValueError: the states are none, see `Rollout.validate`.
    """
    steps = len(ego_states) - 1
    rollout = Rollout(
        name=setup.name,
        arm=setup.arm,
        track_id=setup.track_id,
        motion=setup.motion.name,
        setting=setup.motion.setting,
        planner=planner,
        start_timestamp_us=start.start_timestamp_us,
        dt=setup.dt,
        steps_requested=setup.steps,
        cut_reason=cut_reason,
        ego=ego_states,
        log_ego=start.ego[: steps + 1, [ego.X, ego.Y, ego.HEADING, ego.VX]],
        actor=actors.states(setup.track_id, steps),
        world_from_rig=start.surface.ego_poses(ego_states[:, ego.POSE]),
        world_from_actor=actors.poses(setup.track_id, steps),
        actor_size=setup.track.size,
        ego_size=np.array([setup.vehicle.length, setup.vehicle.width]),
        ego_centre_offset=setup.vehicle.centre_offset,
        predictions=np.array(predictions).reshape(-1, WAYPOINTS, 3),
        plan_steps=np.array(plan_steps, np.int64),
        route=start.route.line.points,
        other_actors=other_ids(setup),
        controlled=tuple(
            ControlledActor(
                track_id=actor.track.track_id,
                category=actor.track.category,
                motion=actor.motion.name,
                setting=actor.motion.setting,
                states=actors.states(actor.track.track_id, steps),
                world_from_actor=actors.poses(actor.track.track_id, steps),
                size=actor.track.size,
            )
            for actor in start.actors[1:]
        ),
        reactive=actors.reactive,
    )
    rollout.validate()
    return replace(read_only(rollout), origin=RolloutOrigin(setup, renderer))
