"""From what a simulator has done to a `Rollout`."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from numpy.typing import NDArray

from recast.dynamics import state as ego
from recast.planning import WAYPOINTS
from recast.simulation.controlled_actor import ControlledActor, RolloutOrigin
from recast.simulation.controlled_actors import ControlledActors
from recast.simulation.other_actors import other_ids
from recast.simulation.renderer import SensorRenderer
from recast.simulation.rollout import Rollout
from recast.simulation.rollout_start import RolloutStart
from recast.simulation.setup import RolloutSetup

Array = NDArray[np.float64]


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
    """A rollout of the states that were reached, validated.

    Args:
        ego_states: (S+1, 11) of the simulated ego.
        predictions, plan_steps: (40, 3) waypoints of each plan, and when it was made.

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
        origin=RolloutOrigin(setup, renderer),
    )
    rollout.validate()
    return rollout
