"""Logged actors that stay in a rollout, on their logged motion."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from recast.geometry import se2
from recast.logs.motion import logged_velocity
from recast.planning import ActorState
from recast.simulation.setup import RolloutSetup

Array = NDArray[np.float64]


def other_ids(setup: RolloutSetup) -> tuple[str, ...]:
    """Ids of the logged tracks that stay; none by default."""
    if not setup.keep_other_actors:
        return ()
    controlled = setup.controlled
    return tuple(key for key in setup.log.tracks if key not in controlled)


def other_poses(setup: RolloutSetup, timestamp_us: int) -> dict[str, Array]:
    """Their logged `world_from_actor` (4, 4) at a time, of those labelled then."""
    trajectories = {key: setup.log.tracks[key].trajectory for key in other_ids(setup)}
    return {k: t.at(timestamp_us) for k, t in trajectories.items() if t.covers(timestamp_us)}


def other_actors(setup: RolloutSetup, timestamp_us: int) -> list[ActorState]:
    """What a planner sees of them; velocities are differences over one step to each side."""
    step = round(setup.dt * 1e6)
    actors = []
    for key, pose in other_poses(setup, timestamp_us).items():
        track = setup.log.tracks[key]
        velocity = logged_velocity(track.trajectory, timestamp_us, step)
        actors.append(ActorState(key, track.category, se2.from_se3(pose), velocity, track.size))
    return actors
