"""Whether two rollouts of a scenario were given the same actor, route and start."""

from __future__ import annotations

import numpy as np

from recast.simulation.rollout import Rollout


def script_difference(one: Rollout, other: Rollout) -> str | None:
    """What differs that no method may change, in words; None where nothing does.

    The actor's states are compared up to the end of the shorter: where its ego leaves the road
    decides how long a rollout is.
    """
    for field in ("track_id", "start_timestamp_us", "dt", "steps_requested", "ego_centre_offset"):
        if getattr(one, field) != getattr(other, field):
            return f"{field} differs: {getattr(one, field)}, not {getattr(other, field)}"
    for field in ("actor_size", "ego_size", "route"):
        if not np.array_equal(getattr(one, field), getattr(other, field)):
            return f"{field} differs"
    if not np.array_equal(one.ego[0], other.ego[0]):
        return "the ego's first state differs"
    common = min(len(one.actor), len(other.actor))
    states = [
        np.hstack([r.actor, r.world_from_actor.reshape(-1, 16)])[:common] for r in (one, other)
    ]
    apart = np.flatnonzero((states[0] != states[1]).any(axis=1))
    return None if len(apart) == 0 else f"the actor's states differ from step {apart[0]} on"
