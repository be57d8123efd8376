"""Logged actors that stay in a rollout, on their logged motion."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from recast.geometry import se2
from recast.planning import ActorState
from recast.simulation.setup import RolloutSetup

Array = NDArray[np.float64]


def other_ids(setup: RolloutSetup) -> tuple[str, ...]:
    """Ids of the logged tracks that stay; none by default."""
    if not setup.keep_other_actors:
        return ()
    return tuple(key for key in setup.log.tracks if key != setup.track_id)


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
        times = track.trajectory.timestamps_us
        around = np.clip([timestamp_us - step, timestamp_us + step], times[0], times[-1])
        moved = np.diff(track.trajectory.at(around)[:, :2, 3], axis=0)[0]
        velocity = moved / max((around[1] - around[0]) * 1e-6, 1e-6)
        actors.append(ActorState(key, track.category, se2.from_se3(pose), velocity, track.size))
    return actors
