"""Whether two rollouts of a scenario were given the same actor, route and start."""

from __future__ import annotations

import numpy as np

from recast.simulation.rollout import Rollout


def script_difference(one: Rollout, other: Rollout) -> str | None:
    """What differs that no arm may change, in words; None where nothing does.

    The states of scripted actors are compared up to the end of the shorter: where its ego leaves
    the road decides how long a rollout is. Of actors that react only the first state is compared.
    """
    for field in ("track_id", "start_timestamp_us", "dt", "steps_requested", "ego_centre_offset"):
        if getattr(one, field) != getattr(other, field):
            return f"{field} differs: {getattr(one, field)}, not {getattr(other, field)}"
    for field in ("actor_size", "ego_size", "route"):
        if not np.array_equal(getattr(one, field), getattr(other, field)):
            return f"{field} differs"
    if not np.array_equal(one.ego[0], other.ego[0]):
        return "the ego's first state differs"
    ids = [[r.track_id, *(actor.track_id for actor in r.controlled)] for r in (one, other)]
    if ids[0] != ids[1] or one.reactive != other.reactive:
        return "the controlled actors differ"
    for track_id, states, others in zip(ids[0], _states(one), _states(other), strict=True):
        common = 1 if track_id in one.reactive else min(len(states), len(others))
        apart = np.flatnonzero((states[:common] != others[:common]).any(axis=1))
        if len(apart):
            who = "the actor" if track_id == one.track_id else f"actor {track_id}"
            return f"{who}'s states differ from step {apart[0]} on"
    return None


def _states(rollout: Rollout) -> list[np.ndarray]:
    """States and poses (S+1, 20) of each controlled actor, the target first."""
    actors = [(rollout.actor, rollout.world_from_actor)]
    actors += [(actor.states, actor.world_from_actor) for actor in rollout.controlled]
    return [np.hstack([states, poses.reshape(-1, 16)]) for states, poses in actors]
