"""Controlled actors that react: moved step by step; and what all actors do without a planner."""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import ArrayLike

from recast.arrays import Array
from recast.core.foreign import read_only
from recast.dynamics import EgoState
from recast.dynamics import state as ego
from recast.planning import ActorState, ReferenceRoute
from recast.simulation.actor_motion import MotionInput, RoadUsers
from recast.simulation.history import History
from recast.simulation.recorded_road import RoadSurface, refuse_if_too_short, who
from recast.simulation.rollout import ego_centre
from recast.simulation.rollout_start import RolloutStart, start_rollout
from recast.simulation.setup import RolloutSetup
from recast.simulation.start_checks import checked_state

EGO = "ego"
"""Track id and category of the ego where it is a road user among others."""
_EGO_HEIGHT = 1.7
"""Metres: nothing depends on it, since road users are compared from above."""


class ReactiveActors:
    """Moves the controlled actors that react, one step at a time.

    Args:
        setup: setup of the rollout.
        start: start from `start_rollout`.
        history: history of the rollout, in which each finds its own states.
    """

    def __init__(self, setup: RolloutSetup, start: RolloutStart, history: History) -> None:
        self._setup, self._history = setup, history
        self._actors = tuple(actor for actor in start.actors if actor.reacts)

    def step(self) -> tuple[dict[str, Array], str | None]:
        """States (4,) after the next step by track id, and why the rollout ends here, if it does:
        one of them would leave the recorded road.

        Raises:
            InputError: a motion returned no state; names the motion, the step and the value.
            Exception: whatever a motion raises.
        """
        moved: dict[str, Array] = {}
        if not self._actors:
            return moved, None
        history, step = self._history, self._history.step
        ego_user, users = _road_user(history.ego[-1], self._setup), history.road_users()
        everyone = RoadUsers((ego_user, *users))
        for actor in self._actors:
            track_id = actor.track.track_id
            now = MotionInput(
                situation=actor.situation,
                step=step,
                steps=self._setup.steps,
                state=history.actor_now(track_id),
                ego=ego_user,
                others=tuple(user for user in users if user.track_id != track_id),
                everyone=everyone,
                travelled=history.travelled(track_id),
            )
            with actor.code.call(f"step {step}"):
                value = actor.motion.step(read_only(now), self._setup.dt)
            state = checked_state(actor.motion, value, step + 1, self._setup.log.name)
            if actor.road.outside(state[:2]):
                return moved, actor.road.reason(who(self._setup, track_id), state[:2])
            moved[track_id] = state
        return moved, None


def _road_user(ego_state: ArrayLike, setup: RolloutSetup) -> ActorState:
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


@dataclass(frozen=True)
class PreparedActor:
    """A further controlled actor as it will move.

    Attributes:
        track_id: id of the actor's track in the log.
        states: (S+1, 4) x, y, heading of the box centre, speed.
        world_from_actor: (S+1, 4, 4) the box centre in space.
    """

    track_id: str
    states: Array
    world_from_actor: Array


@dataclass(frozen=True)
class PreparedRollout:
    """The start of a rollout and what the actors will do.

    What scripted actors do is the same for every planner and arm. Actors that react are shown as
    they would react to the ego as recorded.

    Attributes:
        route, surface: the road.
        start_timestamp_us: log time of state 0.
        ego: (11,) initial ego state.
        log_ego: (S+1, 4) logged ego x, y, heading, speed.
        actor: (S+1, 4) the target: x, y, heading of the box centre, speed.
        world_from_actor: (S+1, 4, 4) the target's box centre in space.
        cut_reason: why S is less than asked for; None if it is not.
        further: the further controlled actors, in order.
    """

    route: ReferenceRoute
    surface: RoadSurface
    start_timestamp_us: int
    ego: Array
    log_ego: Array
    actor: Array
    world_from_actor: Array
    cut_reason: str | None
    further: tuple[PreparedActor, ...] = ()

    @property
    def steps(self) -> int:
        """Steps S that log and road allow to the actors; the ego may leave the road earlier."""
        return len(self.actor) - 1


def prepare(setup: RolloutSetup) -> PreparedRollout:
    """Find the start and what the actors will do, without a planner.

    Raises:
        InputError: see `recast.simulation.rollout_start.start_rollout`; or an actor that reacts
            leaves the recorded road within two plan cycles, or its motion returns no state.
    """
    start = start_rollout(setup)
    # Also where the simulated ego starts beside the recorded one.
    history = History(setup, replace(start, first=start.ego[0]))
    steps, reason = start.steps, start.cut_reason
    if any(actor.reacts for actor in start.actors):
        steps, reason = _react(setup, start, history)
        refuse_if_too_short(setup, steps, reason)
    target, *further = (
        PreparedActor(
            track_id, history.actor_states(track_id, steps), history.actor_poses(track_id, steps)
        )
        for track_id in setup.controlled
    )
    return PreparedRollout(
        route=start.route,
        surface=start.surface,
        start_timestamp_us=start.start_timestamp_us,
        ego=start.first,
        log_ego=start.ego[: steps + 1, [ego.X, ego.Y, ego.HEADING, ego.VX]],
        actor=target.states,
        world_from_actor=target.world_from_actor,
        cut_reason=reason,
        further=tuple(further),
    )


def _react(setup: RolloutSetup, start: RolloutStart, history: History) -> tuple[int, str | None]:
    """Let the actors react to the ego as recorded; steps and the reason why there are not more."""
    actors = ReactiveActors(setup, start, history)
    for step in range(start.steps):
        moved, reason = actors.step()
        if reason is not None:
            return step, reason
        history.append(start.ego[step + 1], 0.0, moved)
    return start.steps, start.cut_reason
