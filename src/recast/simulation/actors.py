"""Actors of a rollout: what they will do, controlled ones step by step, logged ones that stay."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass

import numpy as np
from numpy.typing import ArrayLike

from recast.arrays import Array
from recast.core.foreign import read_only
from recast.dynamics import EgoState, ground_velocities
from recast.dynamics import state as ego
from recast.geometry import se2
from recast.logs.motion import logged_velocity
from recast.planning import ActorState, ReferenceRoute
from recast.simulation.actor_motion import MotionInput, RoadUsers
from recast.simulation.recorded_road import SMOOTHING, RoadSurface, refuse_if_too_short, who
from recast.simulation.rollout import ego_centre
from recast.simulation.rollout_start import RolloutStart, StartingActor, start_rollout
from recast.simulation.setup import RolloutSetup
from recast.simulation.start_checks import checked_state

EGO = "ego"
"""Track id and category of the ego where it is a road user among others."""
_EGO_HEIGHT = 1.7
"""Metres: nothing depends on it, since road users are compared from above."""


class ControlledActors:
    """States and poses of all controlled actors up to now; those that react grow step by step.

    Args:
        setup: setup of the rollout.
        start: start from `start_rollout`.
    """

    def __init__(self, setup: RolloutSetup, start: RolloutStart) -> None:
        self._setup, self._start = setup, start
        self._actors = {actor.track.track_id: actor for actor in start.actors}
        self._states = {k: list(a.states) for k, a in self._actors.items()}
        self._poses = {k: list(a.world_from_actor) for k, a in self._actors.items()}

        self._travelled = dict.fromkeys(self._actors, 0.0)

    @property
    def reactive(self) -> tuple[str, ...]:
        """Track ids of those that react."""
        return tuple(key for key, actor in self._actors.items() if actor.reacts)

    def state(self, track_id: str, step: int) -> Array:
        """x, y, heading of the box centre, speed (4,) at a step that was reached."""
        return self._states[track_id][step]

    def pose(self, track_id: str, step: int) -> Array:
        """`world_from_actor` (4, 4) at a step that was reached."""
        return self._poses[track_id][step]

    def states(self, track_id: str, steps: int) -> Array:
        """States (steps + 1, 4) from the start on."""
        return np.array(self._states[track_id][: steps + 1])

    def poses(self, track_id: str, steps: int) -> Array:
        """`world_from_actor` (steps + 1, 4, 4) from the start on."""
        return np.array(self._poses[track_id][: steps + 1])

    def seen(self, step: int) -> tuple[ActorState, ...]:
        """All road users but the ego at a step: controlled ones, the target first, then logged."""
        timestamp = self._start.start_timestamp_us + step * round(self._setup.dt * 1e6)
        controlled = (self._as_road_user(track_id, step) for track_id in self._actors)
        return (*controlled, *other_actors(self._setup, timestamp))

    def advance(self, ego_state: ArrayLike) -> str | None:
        """Move those that react by one step.

        Args:
            ego_state: (11,) state of the ego before the step.

        Returns:
            Why the rollout ends here, in words, if one of them would leave the recorded road; none
            of them is moved then.

        Raises:
            InputError: a motion returned no state; names the motion, the step and the value.
            Exception: whatever a motion raises.
        """
        if not self.reactive:
            return None
        step = len(self._states[self.reactive[0]]) - 1
        ego_user, users = road_user(ego_state, self._setup), self.seen(step)
        everyone = RoadUsers((ego_user, *users))
        moved: dict[str, Array] = {}
        for track_id in self.reactive:
            actor, states = self._actors[track_id], self._states[track_id]
            now = MotionInput(
                situation=actor.situation,
                step=step,
                steps=self._setup.steps,
                state=states[-1].copy(),
                ego=ego_user,
                others=tuple(user for user in users if user.track_id != track_id),
                everyone=everyone,
                travelled=self._travelled[track_id],
            )
            moved[track_id] = self._moved(actor, now)
            if actor.road.outside(moved[track_id][:2]):
                return actor.road.reason(who(self._setup, track_id), moved[track_id][:2])
        self._append(moved)
        return None

    def _moved(self, actor: StartingActor, now: MotionInput) -> Array:
        with actor.code.call(f"step {now.step}"):
            value = actor.motion.step(read_only(now), self._setup.dt)
        return checked_state(actor.motion, value, now.step + 1, self._setup.log.name)

    def _append(self, moved: Mapping[str, Array]) -> None:
        for track_id, state in moved.items():
            states = self._states[track_id]
            self._travelled[track_id] += float(np.linalg.norm(state[:2] - states[-1][:2]))
            states.append(state)
            # Heights are averaged over the past alone: the future is not known yet.
            recent = np.array(states[-2 * SMOOTHING - 1 :])[:, :3]
            size = self._actors[track_id].track.size
            self._poses[track_id].append(self._start.surface.actor_poses(recent, size)[-1])

    def _as_road_user(self, track_id: str, step: int) -> ActorState:
        first = max(step - 1, 0)
        around = np.array(self._states[track_id][first : step + 2])
        track = self._actors[track_id].track
        return ActorState(
            track_id=track_id,
            category=track.category,
            pose=around[step - first, :3],
            velocity=ground_velocities(around)[step - first],
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
    steps, reason, actors = start.steps, start.cut_reason, ControlledActors(setup, start)
    if actors.reactive:
        steps, reason = _react(actors, start)
        refuse_if_too_short(setup, steps, reason)
    target, *further = (
        PreparedActor(track_id, actors.states(track_id, steps), actors.poses(track_id, steps))
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


def _react(actors: ControlledActors, start: RolloutStart) -> tuple[int, str | None]:
    """Let the actors react to the ego as recorded; steps and the reason why there are not more."""
    for step in range(start.steps):
        reason = actors.advance(start.ego[step])
        if reason is not None:
            return step, reason
    return start.steps, start.cut_reason
