"""Moments of a rollout: the world at a step, and the ego's past before the start."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from recast.dynamics import EgoState, initial_state
from recast.dynamics import state as ego
from recast.simulation.controlled_actors import ControlledActors
from recast.simulation.other_actors import other_poses
from recast.simulation.rollout_start import RolloutStart
from recast.simulation.setup import RolloutSetup
from recast.simulation.state import SimActor, SimState

Array = NDArray[np.float64]

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
        now: (11,) the ego then.
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
    """Logged ego states (11,) before the start, as many as recorded, oldest first."""
    log, step = setup.log.world_from_rig, round(setup.dt * 1e6)
    first = start.start_timestamp_us
    count = min(history_steps(setup), int((first - log.timestamps_us[0]) // step))
    times = [first - step * i for i in range(count, 0, -1)]
    return [initial_state(log.timestamps_us, log.poses, time, setup.vehicle) for time in times]
