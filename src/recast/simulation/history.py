"""What was simulated up to now, how the actors go on, and what they do without a planner."""

from __future__ import annotations

from collections.abc import Iterable, Mapping
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import ArrayLike

from recast.arrays import Array
from recast.core.foreign import read_only
from recast.dynamics import EgoState, VehicleParameters, ground_velocities, initial_state
from recast.dynamics import state as ego
from recast.geometry import se2
from recast.logs import Track, Trajectory
from recast.logs.motion import logged_velocity
from recast.logs.types import VEHICLES
from recast.planning import WAYPOINTS, ActorState, ReferenceRoute
from recast.simulation.actor_motion import EGO, MotionInput, RoadUsers
from recast.simulation.recorded_road import SMOOTHING, RoadSurface, refuse_if_too_short, who
from recast.simulation.renderer import SensorRenderer
from recast.simulation.rollout import (
    ANY_VEHICLE,
    ControlledActor,
    Rollout,
    RolloutOrigin,
    SimActor,
    SimState,
    ego_centre,
)
from recast.simulation.rollout_start import RolloutStart, checked_state, start_rollout
from recast.simulation.setup import RolloutSetup

_SHOWN = 2.0
"""Seconds of past states that a planner is shown."""


class History:
    """The recorded past of a rollout: states of the ego and the controlled actors, and plans.

    Scripted actors have their states of all steps from the start on; those of the ego and of
    actors that react grow step by step.

    Args:
        setup: setup of the rollout.
        start: start from `start_rollout`.

    Attributes:
        ego: states (11,) of the ego, the first one at step 0.
        route_s: coordinates of the ego on the route, metres, each looked for near the last.
        plans: step and waypoints (40, 3) of each plan that was executed.
    """

    def __init__(self, setup: RolloutSetup, start: RolloutStart) -> None:
        self._setup, self._start = setup, start
        self._actors = {actor.track.track_id: actor for actor in start.actors}
        self._states = {key: list(actor.states) for key, actor in self._actors.items()}
        self._poses = {key: list(actor.world_from_actor) for key, actor in self._actors.items()}
        self._travelled = dict.fromkeys(self._actors, 0.0)
        self._traffic = tuple(key for key in self._actors if key not in setup.controlled)
        self._logged = self._logged_past()
        self.ego: list[Array] = [start.first]
        near = start.route.at_time(start.start_timestamp_us)
        self.route_s = [float(start.route.project(start.first, near)[0])]
        self.plans: list[tuple[int, Array]] = []

    @property
    def step(self) -> int:
        """Steps executed up to now."""
        return len(self.ego) - 1

    def timestamp_us(self, step: int) -> int:
        """Log time of a step."""
        return self._start.start_timestamp_us + step * round(self._setup.dt * 1e6)

    def append(self, ego_state: Array, route_s: float, moved: Mapping[str, Array]) -> None:
        """Record one step.

        Args:
            ego_state: (11,) new state of the ego.
            route_s: its coordinate on the route.
            moved: new states (4,) of the actors that react, by track id.
        """
        self.ego.append(ego_state)
        self.route_s.append(route_s)
        for track_id, state in moved.items():
            states = self._states[track_id]
            self._travelled[track_id] += float(np.linalg.norm(state[:2] - states[-1][:2]))
            states.append(state)
            actor = self._actors[track_id]
            if actor.in_space is not None:
                self._poses[track_id].append(actor.in_space())
                continue
            # Heights are averaged over the past alone: the future is not known yet.
            recent = np.array(states[-2 * SMOOTHING - 1 :])[:, :3]
            self._poses[track_id].append(
                self._start.surface.actor_poses(recent, actor.track.size)[-1]
            )

    @property
    def track_ids(self) -> tuple[str, ...]:
        """The controlled actors, the target first, then the traffic."""
        return tuple(self._actors)

    def actor_now(self, track_id: str) -> Array:
        """x, y, heading of the box centre, speed (4,) of a controlled actor now."""
        return self._states[track_id][self.step].copy()

    def actor_states(self, track_id: str, steps: int) -> Array:
        """x, y, heading of the box centre, speed (steps + 1, 4) of a controlled actor."""
        return np.array(self._states[track_id][: steps + 1])

    def actor_poses(self, track_id: str, steps: int) -> Array:
        """`world_from_actor` (steps + 1, 4, 4) of a controlled actor."""
        return np.array(self._poses[track_id][: steps + 1])

    def travelled(self, track_id: str) -> float:
        """Metres that an actor which reacts has moved since the start."""
        return self._travelled[track_id]

    def ego_history(self) -> Array:
        """Ego states (H, 11) of up to 2 s, oldest first, the present one last."""
        return np.array([*self._logged, *self.ego][-_shown(self._setup.dt) - 1 :])

    def road_users(self, foretold: bool = False) -> tuple[ActorState, ...]:
        """All road users but the ego now: controlled ones, the target first, then the traffic.

        Args:
            foretold: fill `ActorState.future` to the end of the rollout where an actor is scripted;
                None where it reacts.
        """
        controlled = (self._as_road_user(track_id, foretold) for track_id in self._actors)
        return tuple(controlled)

    def state(self, step: int) -> SimState:
        """The world at a step up to now, read-only.

        Raises:
            ValueError: the rollout has not come there.
        """
        if not 0 <= step <= self.step:
            raise ValueError(f"Simulator.state_at: expected step 0 to {self.step}, got {step}")
        setup, now, time = self._setup, self.ego[step], self.timestamp_us(step)
        controlled = {}
        for track_id in setup.controlled:
            logged = self._actors[track_id].track.trajectory
            controlled[track_id] = SimActor(
                state=self._states[track_id][step],
                world_from_actor=self._poses[track_id][step],
                log_world_from_actor=logged.at(time) if logged.covers(time) else None,
            )
        target = controlled.pop(setup.track_id)
        state = SimState(
            step=step,
            timestamp_us=time,
            ego=EgoState(now),
            log_ego=self._start.ego[step, [ego.X, ego.Y, ego.HEADING, ego.VX]],
            world_from_rig=self._start.surface.ego_poses(now[ego.POSE]),
            track_id=setup.track_id,
            actor=target.state,
            world_from_actor=target.world_from_actor,
            log_world_from_actor=target.log_world_from_actor,
            others={key: self._poses[key][step] for key in self._traffic},
            further=controlled,
        )
        return read_only(state)

    def rollout(
        self, planner: str, cut_reason: str | None, renderer: SensorRenderer | None
    ) -> Rollout:
        """All that was driven, validated and read-only.

        Args:
            planner: name of who planned.
            cut_reason: why it is shorter than asked for; None if it is not.
            renderer: renderer of its images.

        Raises:
            ValueError: the states are none, see `Rollout.validate`.
        """
        setup, start, steps = self._setup, self._start, self.step
        states = np.array(self.ego)
        further = (
            ControlledActor(
                track_id=track_id,
                category=actor.track.category,
                motion=actor.motion.name,
                setting=actor.motion.setting,
                states=self.actor_states(track_id, steps),
                world_from_actor=self.actor_poses(track_id, steps),
                size=actor.track.size,
            )
            for track_id, actor in list(self._actors.items())[1:]
        )
        rollout = Rollout(
            name=setup.name,
            arm=setup.arm,
            track_id=setup.track_id,
            category=ANY_VEHICLE if (own := setup.track.category) in VEHICLES else own,
            motion=setup.motion.name,
            setting=setup.motion.setting,
            planner=planner,
            start_timestamp_us=start.start_timestamp_us,
            dt=setup.dt,
            steps_requested=setup.steps,
            cut_reason=cut_reason,
            ego=states,
            log_ego=start.ego[: steps + 1, [ego.X, ego.Y, ego.HEADING, ego.VX]],
            actor=self.actor_states(setup.track_id, steps),
            world_from_rig=start.surface.ego_poses(states[:, ego.POSE]),
            world_from_actor=self.actor_poses(setup.track_id, steps),
            actor_size=setup.track.size,
            ego_size=np.array([setup.vehicle.length, setup.vehicle.width]),
            ego_centre_offset=setup.vehicle.centre_offset,
            predictions=np.array([plan for _, plan in self.plans]).reshape(-1, WAYPOINTS, 3),
            plan_steps=np.array([step for step, _ in self.plans], np.int64),
            route=start.route.line.points,
            other_actors=self._traffic,
            controlled=tuple(further),
            reactive=tuple(key for key, actor in self._actors.items() if actor.reacts),
        )
        rollout.validate()
        return replace(read_only(rollout), origin=RolloutOrigin(setup, renderer))

    def _logged_past(self) -> list[Array]:
        """Ego states (11,) before the start, as many as recorded, oldest first.

        They are the logged ones, moved as the start is (`RolloutSettings.start_left`).
        """
        setup, first = self._setup, self._start.start_timestamp_us
        past = logged_past(setup.log.world_from_rig, first, setup.dt, setup.vehicle)
        left = setup.start_left
        return [ego.moved_left(state, left) for state in past] if left else past

    def _as_road_user(self, track_id: str, foretold: bool) -> ActorState:
        first = max(self.step - 1, 0)
        around = np.array(self._states[track_id][first : self.step + 2])
        actor = self._actors[track_id]
        track, future = actor.track, None
        if foretold and not actor.reacts:
            future = np.array(self._states[track_id][self.step :])[:, :3]
        return ActorState(
            track_id=track_id,
            category=track.category,
            pose=around[self.step - first, :3],
            velocity=ground_velocities(around)[self.step - first],
            size=track.size,
            future=future,
        )


def logged_road_users(
    tracks: Iterable[Track], timestamp_us: int, dt: float, foretold: bool = False
) -> tuple[ActorState, ...]:
    """What a planner sees of the tracks that are labelled at a time.

    Velocities are differences over one step of `dt` seconds to each side.

    Args:
        foretold: fill `ActorState.future`, to the end of the label.
    """
    step = round(dt * 1e6)

    def future(path: Trajectory) -> Array | None:
        if not foretold:
            return None
        return se2.from_se3(path.at(np.arange(timestamp_us, path.timestamps_us[-1] + 1, step)))

    return tuple(
        ActorState(
            track.track_id,
            track.category,
            se2.from_se3(track.trajectory.at(timestamp_us)),
            logged_velocity(track.trajectory, timestamp_us, step),
            track.size,
            future(track.trajectory),
        )
        for track in tracks
        if track.trajectory.covers(timestamp_us)
    )


def logged_past(
    log: Trajectory, timestamp_us: int, dt: float, vehicle: VehicleParameters
) -> list[Array]:
    """Ego states (11,) of the 2 s before a time, as many as recorded, `dt` apart, oldest first."""
    step = round(dt * 1e6)
    count = min(_shown(dt), int((timestamp_us - log.timestamps_us[0]) // step))
    times = [timestamp_us - step * back for back in range(count, 0, -1)]
    return [initial_state(log.timestamps_us, log.poses, time, vehicle) for time in times]


def _shown(dt: float) -> int:
    """Past states that a planner is shown, besides the present one."""
    return round(_SHOWN / dt)


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
            given = now if actor.road is None else read_only(now)  # traffic is code of ours
            with actor.code.call(f"step {step}"):
                value = actor.motion.step(given, self._setup.dt)
            state = checked_state(actor.motion, value, step + 1, self._setup.log.name)
            if actor.road is not None and actor.road.outside(state[:2]):
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
        further: the further controlled actors in order, then the traffic.
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
        for track_id in history.track_ids
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
