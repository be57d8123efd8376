"""The controlled actors of a running rollout: scripts, and who reacts, step by step."""

from __future__ import annotations

from collections.abc import Mapping
from typing import cast

import numpy as np
from numpy.typing import ArrayLike, NDArray

from recast.dynamics import EgoState
from recast.dynamics import state as ego
from recast.planning import ActorState
from recast.simulation.actor_motion import ActorMotion, MotionInput
from recast.simulation.lift import SMOOTHING
from recast.simulation.motion_checks import checked_state
from recast.simulation.other_actors import other_actors
from recast.simulation.recorded_road import who
from recast.simulation.rollout import ego_centre
from recast.simulation.rollout_start import RolloutStart, StartingActor
from recast.simulation.setup import RolloutSetup

Array = NDArray[np.float64]

EGO = "ego"
"""Track id and category of the ego where it is a road user among others."""
_EGO_HEIGHT = 1.7
"""Metres: nothing depends on it, since road users are compared from above."""


class ControlledActors:
    """States and poses of all controlled actors up to now; those that react grow step by step.

    Args:
        setup: of the rollout.
        start: from `start_rollout`.
    """

    def __init__(self, setup: RolloutSetup, start: RolloutStart) -> None:
        self._setup, self._start = setup, start
        self._actors = {actor.track.track_id: actor for actor in start.actors}
        self._states = {k: list(a.states) for k, a in self._actors.items() if a.reacts}
        self._poses = {k: list(a.world_from_actor) for k, a in self._actors.items() if a.reacts}

    @property
    def react(self) -> bool:
        """Whether some of them react."""
        return bool(self._states)

    @property
    def reactive(self) -> tuple[str, ...]:
        """Track ids of those that react."""
        return tuple(self._states)

    def state(self, track_id: str, step: int) -> Array:
        """x, y, heading of the box centre, speed (4,) at a step that was reached."""
        if track_id in self._states:
            return self._states[track_id][step]
        state: Array = self._actors[track_id].states[step]
        return state

    def pose(self, track_id: str, step: int) -> Array:
        """`world_from_actor` (4, 4) at a step that was reached."""
        if track_id in self._poses:
            return self._poses[track_id][step]
        pose: Array = self._actors[track_id].world_from_actor[step]
        return pose

    def states(self, track_id: str, steps: int) -> Array:
        """States (steps + 1, 4) from the start on."""
        if track_id in self._states:
            return np.array(self._states[track_id][: steps + 1])
        return self._actors[track_id].states[: steps + 1]

    def poses(self, track_id: str, steps: int) -> Array:
        """`world_from_actor` (steps + 1, 4, 4) from the start on."""
        if track_id in self._poses:
            return np.array(self._poses[track_id][: steps + 1])
        return self._actors[track_id].world_from_actor[: steps + 1]

    def seen(self, step: int) -> tuple[ActorState, ...]:
        """All road users but the ego at a step: controlled ones, the target first, then logged."""
        timestamp = self._start.start_timestamp_us + step * round(self._setup.dt * 1e6)
        controlled = (self._as_road_user(track_id, step) for track_id in self._actors)
        return (*controlled, *other_actors(self._setup, timestamp))

    def advance(self, ego_state: ArrayLike) -> str | None:
        """Move those that react by one step.

        Args:
            ego_state: (11,) the ego before the step.

        Returns:
            Why the rollout ends here, in words, if one of them would leave the recorded road; none
            of them is moved then.

        Raises:
            InputError: a motion returned no state; names the motion, the step and the value.
            Exception: whatever a motion raises.
        """
        if not self.react:
            return None
        step = min(map(len, self._states.values())) - 1
        ego_user, users = road_user(ego_state, self._setup), self.seen(step)
        moved: dict[str, Array] = {}
        for track_id, states in self._states.items():
            actor = self._actors[track_id]
            now = MotionInput(
                situation=actor.situation,
                step=step,
                steps=self._setup.steps,
                state=states[-1].copy(),
                ego=ego_user,
                others=tuple(user for user in users if user.track_id != track_id),
            )
            moved[track_id] = self._moved(actor, now)
            if actor.road.outside(moved[track_id][:2]):
                return actor.road.reason(who(self._setup, track_id), moved[track_id][:2])
        self._append(moved)
        return None

    def _moved(self, actor: StartingActor, now: MotionInput) -> Array:
        motion = cast(ActorMotion, actor.motion)  # those with a script do not come here
        value = motion.step(now, self._setup.dt)
        return checked_state(motion, value, now.step + 1, self._setup.log.name)

    def _append(self, moved: Mapping[str, Array]) -> None:
        for track_id, state in moved.items():
            states = self._states[track_id]
            states.append(state)
            # Heights are averaged over the past alone: the future is not known yet.
            recent = np.array(states[-2 * SMOOTHING - 1 :])[:, :3]
            size = self._actors[track_id].track.size
            self._poses[track_id].append(self._start.surface.actor_poses(recent, size)[-1])

    def _as_road_user(self, track_id: str, step: int) -> ActorState:
        x, y, heading, speed = self.state(track_id, step)
        track = self._actors[track_id].track
        return ActorState(
            track_id=track_id,
            category=track.category,
            pose=np.array([x, y, heading]),
            velocity=speed * np.array([np.cos(heading), np.sin(heading)]),
            size=track.size,
        )


def road_user(ego_state: ArrayLike, setup: RolloutSetup) -> ActorState:
    """The ego (11,) as other road users see it: box and velocity in the world."""
    state, vehicle = EgoState(ego_state), setup.vehicle
    cos, sin = np.cos(state.heading), np.sin(state.heading)
    along, across = state[ego.VX], state[ego.VY]
    return ActorState(
        track_id=EGO,
        category=EGO,
        pose=ego_centre(state.pose, vehicle.centre_offset),
        velocity=np.array([along * cos - across * sin, along * sin + across * cos]),
        size=np.array([vehicle.length, vehicle.width, _EGO_HEIGHT]),
    )
