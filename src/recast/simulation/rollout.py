"""What a closed-loop rollout leaves behind: enough for each metric and each frame."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field, replace
from typing import Any

import numpy as np

from recast.arrays import Array, Int64Array
from recast.dynamics import EgoState
from recast.dynamics.state import COLUMNS
from recast.logs.checks import BOX_SIDE, LATEST_US, WORLD_REACH, check_poses
from recast.planning import WAYPOINTS
from recast.simulation.state import (
    ControlledActor,
    RolloutOrigin,
    SimActor,
    SimState,
    check_array,
    check_limited,
)

EGO_COLUMNS = COLUMNS
"""Columns of `Rollout.ego`: rear axle; pose in the world, the rest in the ego frame, SI units."""

PATH_COLUMNS = ("x", "y", "heading", "speed")
"""Columns of `Rollout.log_ego` (rear axle) and `Rollout.actor` (box centre), world frame."""

_RANGES = {
    "start_timestamp_us": (0, LATEST_US),
    "dt": (1e-3, 10.0),
    "steps_requested": (1, 1e9),
    "actor_size": BOX_SIDE,
    "ego_size": BOX_SIDE,
    "ego_centre_offset": (-BOX_SIDE[1], BOX_SIDE[1]),
}
_TEXTS = ("name", "arm", "track_id", "motion", "setting", "planner", "cut_reason")
_LONGEST_TEXT = 4000
"""Names are shorter (`NAME_LIMIT`); a rollout's joins two, and a reason may quote some."""


@dataclass(frozen=True)
class Rollout:
    """One closed-loop rollout of S executed steps, with states k = 0..S and C plans.

    Attributes:
        name: name of the rollout, unique within a batch.
        arm: what rendered the actor ("native", "recast", ...); the states of a scripted actor do
            not depend on it.
        track_id: the target, the first controlled vehicle.
        motion: name of the motion, as in `recast.simulation.motions`, for example "cut-in".
        setting: name of its setting, for example "a".
        planner: the planner's name.
        start_timestamp_us: log time of state 0.
        dt: seconds between states.
        steps_requested: steps that were asked for.
        cut_reason: why `steps_run` is less, in words; None where nothing was cut.
        ego: (S+1, 11) simulated ego, see `EGO_COLUMNS`.
        log_ego: (S+1, 4) logged ego at the same times, see `PATH_COLUMNS`.
        actor: (S+1, 4) the target, see `PATH_COLUMNS`; speed is along its motion, >= 0.
        world_from_rig: (S+1, 4, 4) the simulated ego in space: with height, pitch and roll.
        world_from_actor: (S+1, 4, 4) the actor's box centre in space.
        actor_size: (3,) length, width, height of the logged box, metres.
        ego_size: (2,) length and width of the ego's box, metres.
        ego_centre_offset: metres from the rear axle forward to the ego's box centre.
        predictions: (C, 40, 3) the planner's waypoints x, y, heading in the ego frame at its
            plan step, times 0.1 s .. 4.0 s.
        plan_steps: (C,) int64, the step at which each plan was made.
        route: (R, 2) the reference route: the logged ego path, smoothed, rear axle.
        other_actors: ids of logged tracks that kept their logged motion.
        controlled: controlled actors beside the target, in order.
        reactive: ids of controlled actors that react: their states depend on the ego's.
        origin: what this process ran it with; None for a rollout that was read. It is not saved,
            compared or pickled.
    """

    name: str
    arm: str
    track_id: str
    motion: str
    setting: str
    planner: str
    start_timestamp_us: int
    dt: float
    steps_requested: int
    cut_reason: str | None
    ego: Array
    log_ego: Array
    actor: Array
    world_from_rig: Array
    world_from_actor: Array
    actor_size: Array
    ego_size: Array
    ego_centre_offset: float
    predictions: Array
    plan_steps: Int64Array
    route: Array
    other_actors: tuple[str, ...] = ()
    controlled: tuple[ControlledActor, ...] = ()
    reactive: tuple[str, ...] = ()
    origin: RolloutOrigin | None = field(default=None, compare=False, repr=False)

    def __getstate__(self) -> dict[str, Any]:
        # Another process neither needs the log nor can use the renderer.
        return {**self.__dict__, "origin": None}

    @property
    def steps_run(self) -> int:
        """Executed steps S."""
        return len(self.ego) - 1

    @property
    def ego_boxes(self) -> Array:
        """(S+1, 3) x, y, heading of the ego's box centre."""
        return ego_centre(self.ego[:, :3], self.ego_centre_offset)

    def timestamp_us(self, step: int) -> int:
        """Log time of state `step`."""
        return self.start_timestamp_us + round(step * self.dt * 1e6)

    def state(self, step: int, others: Mapping[str, Array] | None = None) -> SimState:
        """The world at a step, to be rendered again.

        Args:
            others: `world_from_actor` (4, 4) by track id of logged actors that are drawn too.
        """
        return SimState(
            step=step,
            timestamp_us=self.timestamp_us(step),
            ego=EgoState(self.ego[step]),
            log_ego=self.log_ego[step],
            world_from_rig=self.world_from_rig[step],
            track_id=self.track_id,
            actor=self.actor[step],
            world_from_actor=self.world_from_actor[step],
            others={} if others is None else others,
            further={
                one.track_id: SimActor(one.states[step], one.world_from_actor[step])
                for one in self.controlled
            },
        )

    def first(self, steps: int) -> Rollout:
        """The same rollout, ended after `steps`, 1 to S."""
        if not 1 <= steps <= self.steps_run:
            raise ValueError(f"Rollout.first: expected 1 to {self.steps_run} steps, got {steps}")
        plans = int(np.searchsorted(self.plan_steps, steps))
        states = {
            name: getattr(self, name)[: steps + 1]
            for name in ("ego", "log_ego", "actor", "world_from_rig", "world_from_actor")
        }
        return replace(
            self,
            **states,
            predictions=self.predictions[:plans],
            plan_steps=self.plan_steps[:plans],
            controlled=tuple(actor.first(steps) for actor in self.controlled),
        )

    def validate(self) -> None:
        """Raise ValueError naming the field at fault, and its shape or value."""
        states, plans = len(self.ego), len(self.plan_steps)
        for name, shape in _shapes(states, plans).items():
            kind = "i" if name == "plan_steps" else "f"
            check_array(f"Rollout.{name}", getattr(self, name), shape, kind)
        if states < 2:
            raise ValueError(f"Rollout.ego: needs two states or more, got {states}")
        for name, (low, high) in _RANGES.items():
            values = np.asarray(getattr(self, name), np.float64)
            if not np.all((values >= low) & (values <= high)):
                raise ValueError(f"Rollout.{name}: is {values}, not within {low:g} and {high:g}")
        texts = [(name, getattr(self, name) or "") for name in _TEXTS]
        texts += [
            (name, key) for name in ("other_actors", "reactive") for key in getattr(self, name)
        ]
        for name, text in texts:
            check_limited(f"Rollout.{name}", text, _LONGEST_TEXT)
        for actor in self.controlled:
            actor.validate(states)
        ids = [self.track_id, *(actor.track_id for actor in self.controlled)]
        if len(set(ids)) < len(ids):
            raise ValueError(f"Rollout.controlled: has a track twice: {', '.join(ids)}")
        if np.any(self.actor[:, 3] < 0):
            raise ValueError("Rollout.actor: has a negative speed")
        for name in ("world_from_rig", "world_from_actor"):
            check_poses(f"Rollout.{name}", getattr(self, name), WORLD_REACH)
        if self.steps_run > self.steps_requested:
            raise ValueError(
                f"Rollout.steps_requested: {self.steps_requested}, but {self.steps_run} were run"
            )
        if np.any(np.diff(self.plan_steps) <= 0) or (
            plans and not 0 <= self.plan_steps[0] <= self.plan_steps[-1] < self.steps_run
        ):
            raise ValueError(
                f"Rollout.plan_steps: must increase within [0, {self.steps_run}), "
                f"got {self.plan_steps.tolist()}"
            )


@dataclass(frozen=True)
class RolloutFailure:
    """A rollout that ended in an error: a row of the report, not the end of the batch.

    Attributes:
        name, arm, track_id, motion, setting, planner: the rollout's, as in `Rollout`.
        error: the exception's class.
        reason: its message.
        traceback: traceback of the exception, the last `running.TRACEBACK_LIMIT` characters; "" in
            records of an older recast.
    """

    name: str
    arm: str
    track_id: str
    motion: str
    setting: str
    planner: str
    error: str
    reason: str
    traceback: str = ""


def ego_centre(rear_axle: Array, offset: float) -> Array:
    """Box-centre poses (..., 3) of rear-axle poses (..., 3), `offset` metres ahead."""
    centre = rear_axle.copy()
    centre[..., 0] += offset * np.cos(rear_axle[..., 2])
    centre[..., 1] += offset * np.sin(rear_axle[..., 2])
    return centre


def _shapes(states: int, plans: int) -> dict[str, tuple[int | None, ...]]:
    return {
        "ego": (states, len(EGO_COLUMNS)),
        "log_ego": (states, len(PATH_COLUMNS)),
        "actor": (states, len(PATH_COLUMNS)),
        "world_from_rig": (states, 4, 4),
        "world_from_actor": (states, 4, 4),
        "actor_size": (3,),
        "ego_size": (2,),
        "predictions": (plans, WAYPOINTS, 3),
        "plan_steps": (plans,),
        "route": (None, 2),
    }
