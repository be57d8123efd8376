"""The closed loop: render, plan, move the ego, move the actor, and again."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass
from time import perf_counter

import numpy as np
from numpy.typing import NDArray

from recast.dynamics import initial_state
from recast.dynamics import state as ego
from recast.planning import (
    WAYPOINTS,
    ActorState,
    Plan,
    Planner,
    PlannerInput,
    PlanningContext,
    planner_cameras,
)
from recast.simulation.other_actors import other_actors, other_ids, other_poses
from recast.simulation.prepare import (
    PreparedRollout,
    off_road,
    off_road_cut,
    prepare,
    refuse_if_too_short,
)
from recast.simulation.renderer import SensorRenderer
from recast.simulation.rollout import Rollout
from recast.simulation.setup import RolloutSetup
from recast.simulation.state import SimState

Array = NDArray[np.float64]
Image = NDArray[np.uint8]

OnFrame = Callable[[SimState, Mapping[str, Image]], None]
"""Called with each state k = 0 .. S-1 in order and its images."""

_HISTORY = 2.0
"""Seconds of past states that a planner is shown."""


@dataclass
class Timings:
    """Wall-clock seconds; kept apart from the rollout, which is deterministic."""

    render: float = 0.0
    plan: float = 0.0
    control: float = 0.0
    frames: int = 0


def run_rollout(
    setup: RolloutSetup,
    planner: Planner,
    renderer: SensorRenderer | None = None,
    on_frame: OnFrame | None = None,
    timings: Timings | None = None,
) -> Rollout:
    """Run one rollout; never stopped by a collision.

    Rendered are the planner's cameras at the plan steps if it needs images, the setup's cameras at
    every step if `on_frame` is given, and nothing otherwise.

    Args:
        renderer: needed where anything is rendered.
        on_frame: receives states and images, for a film.
        timings: is added to.

    Raises:
        InputError: see `prepare` and `planner_cameras`; or the ego leaves the recorded road within
            two plan cycles.
        ValueError: the planner's answer is no plan or took too long, or a renderer is missing.
        Exception: whatever the planner raises.
    """
    return _Loop(setup, planner, renderer, on_frame, timings or Timings()).run()


class _Loop:
    def __init__(
        self,
        setup: RolloutSetup,
        planner: Planner,
        renderer: SensorRenderer | None,
        on_frame: OnFrame | None,
        timings: Timings,
    ) -> None:
        if renderer is None and (planner.needs_images or on_frame is not None):
            who = f"planner {planner.name}" if planner.needs_images else "on_frame"
            raise ValueError(f"run_rollout: {who} needs images, so give a renderer")
        self.setup, self.planner, self.timings = setup, planner, timings
        self.renderer, self.on_frame = renderer, on_frame
        names = tuple(setup.log.cameras if setup.camera_names is None else setup.camera_names)
        self.mounts = {} if renderer is None else renderer.mounts
        self.seen = planner_cameras(planner, self.mounts, names)
        self.filmed = () if on_frame is None else names
        self.prepared = prepare(setup)
        self.states = [self.prepared.ego]
        self.predictions: list[Array] = []
        self.plan_steps: list[int] = []
        self.past = _logged_past(setup, self.prepared)
        self.cut_reason = self.prepared.cut_reason

    def run(self) -> Rollout:
        self.planner.reset(
            PlanningContext(
                route=self.prepared.route,
                log=self.setup.log.world_from_rig,
                map=self.setup.hdmap,
                vehicle=self.setup.vehicle,
                cameras={name: self.mounts[name] for name in self.seen},
                dt=self.setup.dt,
                plan_every=self.setup.plan_every,
            )
        )
        ended = False
        while not ended and self.step < self.prepared.steps:
            ended = self._cycle()
        refuse_if_too_short(self.setup, self.step, self.cut_reason)
        return self._rollout()

    @property
    def step(self) -> int:
        return len(self.states) - 1

    def _cycle(self) -> bool:
        """One plan and its execution; True where the ego came to the end of the road."""
        first = self.step
        images: dict[str, Image] = {}
        if self.seen:
            # One call for both, since a renderer may draw its cameras side by side.
            images = self._render(self._state(first), tuple(dict.fromkeys(self.seen + self.filmed)))
        plan = self._plan({name: images[name] for name in self.seen})

        steps = min(self.setup.plan_every, self.prepared.steps - first)
        began = perf_counter()
        executed = self.setup.controller.execute(
            self.states[-1], plan.waypoints, steps, self.setup.vehicle, self.setup.dt
        )[1:]
        self.timings.control += perf_counter() - began
        outside = off_road(self.prepared.route, executed[:, :2], self.setup.road_margin)
        kept = int(np.argmax(outside)) if outside.any() else steps
        if kept < steps:
            self.cut_reason = off_road_cut(self.setup, self.prepared.route, executed[kept, :2])
        if kept > 0:
            self.states.extend(executed[:kept])
            self.predictions.append(np.asarray(plan.waypoints, np.float64))
            self.plan_steps.append(first)
        if self.on_frame is not None:
            for step in range(first, first + kept):
                state = self._state(step)
                if step > first or not images:
                    images = self._render(state, self.filmed)
                self.on_frame(state, {name: images[name] for name in self.filmed})
        return kept < steps

    def _plan(self, images: dict[str, Image]) -> Plan:
        now = self.states[-1]
        history = np.array([*self.past, *self.states][-_history(self.setup) - 1 :])
        observation = PlannerInput(
            step=self.step,
            timestamp_us=self._timestamp(self.step),
            ego=now,
            ego_history=history,
            actors=self._actors(),
            command=self.prepared.route.command(now),
            images=images,
        )
        began = perf_counter()
        plan = self.planner.plan(observation)
        took = perf_counter() - began
        self.timings.plan += took
        limit = self.setup.plan_limit_s
        if limit is not None and took > limit:
            raise ValueError(
                f"planner {self.planner.name}: took {took:.3g} s for the plan at step {self.step}, "
                f"the limit is {limit:g} s"
            )
        if not isinstance(plan, Plan):
            raise ValueError(
                f"planner {self.planner.name}: returned {type(plan).__name__}, not a Plan"
            )
        try:
            plan.validate()
        except ValueError as error:
            raise ValueError(f"planner {self.planner.name}: {error}") from None
        return plan

    def _render(self, state: SimState, names: tuple[str, ...]) -> dict[str, Image]:
        assert self.renderer is not None  # checked in __init__
        began = perf_counter()
        images = self.renderer.render(state, names)
        self.timings.render += perf_counter() - began
        self.timings.frames += len(images)
        return images

    def _timestamp(self, step: int) -> int:
        return self.prepared.start_timestamp_us + step * round(self.setup.dt * 1e6)

    def _state(self, step: int) -> SimState:
        timestamp = self._timestamp(step)
        logged = self.setup.track.trajectory
        return SimState(
            step=step,
            timestamp_us=timestamp,
            ego=self.states[step],
            log_ego=self.prepared.log_ego[step],
            world_from_rig=self.prepared.surface.ego_poses(self.states[step][ego.POSE]),
            track_id=self.setup.track_id,
            actor=self.prepared.actor[step],
            world_from_actor=self.prepared.world_from_actor[step],
            log_world_from_actor=logged.at(timestamp) if logged.covers(timestamp) else None,
            others=other_poses(self.setup, timestamp),
        )

    def _actors(self) -> tuple[ActorState, ...]:
        """The controlled actor first, then the logged ones that stay."""
        x, y, heading, speed = self.prepared.actor[self.step]
        controlled = ActorState(
            track_id=self.setup.track_id,
            category=self.setup.track.category,
            pose=np.array([x, y, heading]),
            velocity=speed * np.array([np.cos(heading), np.sin(heading)]),
            size=self.setup.track.size,
        )
        return (controlled, *other_actors(self.setup, self._timestamp(self.step)))

    def _rollout(self) -> Rollout:
        setup, prepared, kept = self.setup, self.prepared, self.step + 1
        states = np.array(self.states)
        rollout = Rollout(
            name=setup.name,
            method=setup.method,
            track_id=setup.track_id,
            motion=setup.motion.name,
            setting=setup.motion.setting,
            planner=self.planner.name,
            start_timestamp_us=prepared.start_timestamp_us,
            dt=setup.dt,
            steps_requested=setup.steps,
            cut_reason=self.cut_reason,
            ego=states,
            log_ego=prepared.log_ego[:kept],
            actor=prepared.actor[:kept],
            world_from_rig=prepared.surface.ego_poses(states[:, ego.POSE]),
            world_from_actor=prepared.world_from_actor[:kept],
            actor_size=setup.track.size,
            ego_size=np.array([setup.vehicle.length, setup.vehicle.width]),
            ego_centre_offset=setup.vehicle.centre_offset,
            predictions=np.array(self.predictions).reshape(-1, WAYPOINTS, 3),
            plan_steps=np.array(self.plan_steps, np.int64),
            route=prepared.route.line.points,
            other_actors=other_ids(setup),
        )
        rollout.validate()
        return rollout


def _logged_past(setup: RolloutSetup, prepared: PreparedRollout) -> list[Array]:
    """Logged ego states before the start, as many as recorded, oldest first."""
    log, step = setup.log.world_from_rig, round(setup.dt * 1e6)
    count = min(_history(setup), int((prepared.start_timestamp_us - log.timestamps_us[0]) // step))
    times = [prepared.start_timestamp_us - step * i for i in range(count, 0, -1)]
    return [initial_state(log.timestamps_us, log.poses, time, setup.vehicle) for time in times]


def _history(setup: RolloutSetup) -> int:
    return round(_HISTORY / setup.dt)
