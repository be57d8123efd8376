"""What is simulated: the world at one step, and what a whole rollout leaves behind.

A rollout has enough for each metric and each frame.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field, replace
from typing import TYPE_CHECKING, Any

import numpy as np

from recast.arrays import Array, Int64Array
from recast.core.brief import Brief
from recast.dynamics import EgoState
from recast.dynamics.state import COLUMNS
from recast.logs.checks import BOX_SIDE, LATEST_US, NAME_LIMIT, WORLD_REACH, check_poses, check_text
from recast.logs.types import PEOPLE
from recast.planning import WAYPOINTS

if TYPE_CHECKING:
    from recast.simulation.renderer import SensorRenderer
    from recast.simulation.setup import RolloutSetup


@dataclass(frozen=True)
class SimActor:
    """A controlled actor at one step.

    Attributes:
        state: (4,) x, y, heading of its box centre, speed.
        world_from_actor: (4, 4) its box centre in space.
        log_world_from_actor: (4, 4) where the log has it now; None where it is not labelled.
    """

    state: Array
    world_from_actor: Array
    log_world_from_actor: Array | None = None


@dataclass(frozen=True)
class SimState:
    """The world at one step.

    Attributes:
        step: 0 at the start.
        timestamp_us: log time of the step.
        ego: (11,) simulated ego, by name or by the columns of `recast.dynamics.state`; a plain
            array that is given becomes one.
        log_ego: (4,) logged ego at this time: x, y, heading of the rear axle, speed.
        world_from_rig: (4, 4) the simulated ego in space.
        track_id: the target, the first controlled actor.
        actor: (4,) x, y, heading of its box centre, speed.
        world_from_actor: (4, 4) its box centre in space.
        log_world_from_actor: (4, 4) where the log has it now; None where it is not labelled.
        others: `world_from_actor` (4, 4) by track id of road users that no scenario moves: the
            traffic, or those at a moment of the log. Those that a scene has no model of are part of
            its background, or not drawn.
        further: the further controlled actors by track id.
    """

    step: int
    timestamp_us: int
    ego: EgoState
    log_ego: Array
    world_from_rig: Array
    track_id: str
    actor: Array
    world_from_actor: Array
    log_world_from_actor: Array | None = None
    others: Mapping[str, Array] = field(default_factory=dict)
    further: Mapping[str, SimActor] = field(default_factory=dict)

    def __post_init__(self) -> None:
        object.__setattr__(self, "ego", EgoState(self.ego))

    @property
    def actors(self) -> dict[str, SimActor]:
        """All controlled actors by track id, the target first."""
        target = SimActor(self.actor, self.world_from_actor, self.log_world_from_actor)
        return {self.track_id: target, **self.further}

    @property
    def poses(self) -> dict[str, Array]:
        """Poses (4, 4) of all actors to draw, by track id; whoever is absent is not drawn."""
        controlled = {key: actor.world_from_actor for key, actor in self.actors.items()}
        return {**self.others, **controlled}

    @property
    def log_mounts(self) -> Mapping[str, Array]:
        """`rig_from_camera` (4, 4) of the log's cameras, if this is a moment of the log: a scene
        then has cameras and vehicles where training learned that they were. None in a simulation.
        """
        return {}


@dataclass(frozen=True)
class RolloutOrigin:
    """What a rollout of this process was run with: metrics find the map in it, reports the scene.

    Attributes:
        setup: setup of the rollout.
        renderer: renderer of its images; None if nothing was rendered.
    """

    setup: RolloutSetup
    renderer: SensorRenderer | None


@dataclass(frozen=True)
class ControlledActor:
    """A controlled actor beside the target, with states k = 0..S.

    Attributes:
        track_id: id of the actor's track in the log.
        category: category of the actor, as in `Track.category`.
        motion, setting: names of what it did.
        states: (S+1, 4) x, y, heading of the box centre, speed >= 0; world, SI units.
        world_from_actor: (S+1, 4, 4) the box centre in space.
        size: (3,) length, width, height of the logged box, metres.
    """

    track_id: str
    category: str
    motion: str
    setting: str
    states: Array
    world_from_actor: Array
    size: Array

    def first(self, steps: int) -> ControlledActor:
        """The same actor up to the state after `steps`."""
        return replace(
            self,
            states=self.states[: steps + 1],
            world_from_actor=self.world_from_actor[: steps + 1],
        )

    def validate(self, states: int) -> None:
        """Raise ValueError naming the field at fault.

        Args:
            states: number of states of the rollout.
        """
        for name in ("track_id", "category", "motion", "setting"):
            check_limited(f"Rollout.controlled: {name}", getattr(self, name), NAME_LIMIT)
        where = f"Rollout.controlled[{self.track_id!r}]"
        shapes = {"states": (states, 4), "world_from_actor": (states, 4, 4), "size": (3,)}
        for name, shape in shapes.items():
            check_array(f"{where}.{name}", getattr(self, name), shape)
        if np.any(self.states[:, 3] < 0):
            raise ValueError(f"{where}.states: has a negative speed")
        low, high = BOX_SIDE
        if not np.all((self.size >= low) & (self.size <= high)):
            raise ValueError(f"{where}.size: is {self.size}, not within {low:g} and {high:g}")
        check_poses(f"{where}.world_from_actor", self.world_from_actor, WORLD_REACH)


def check_array(
    where: str, value: Array | Int64Array, shape: tuple[int | None, ...], kind: str = "f"
) -> None:
    """Raise ValueError unless an array has a shape (None: any length) and holds possible numbers.

    Args:
        kind: kind of the array's dtype, as in `numpy.dtype.kind`.
    """
    fits = value.ndim == len(shape) and all(
        want is None or have == want for have, want in zip(value.shape, shape, strict=True)
    )
    if not fits:
        raise ValueError(f"{where}: expected {shape}, got {value.shape}")
    if value.dtype.kind != kind:
        raise ValueError(f"{where}: has the wrong type {value.dtype}")
    if not np.all(np.isfinite(value)):
        raise ValueError(f"{where}: holds NaN or infinity")
    # Metres of the world are the largest; whatever is larger in another unit is no motion either.
    if np.any(np.abs(value) > WORLD_REACH):
        raise ValueError(f"{where}: holds a number beyond {WORLD_REACH:g}")


def check_limited(where: str, text: str, limit: int) -> None:
    """Raise ValueError unless it is a text of at most `limit` characters."""
    check_text(where, text)
    if len(text) > limit:
        raise ValueError(f"{where}: has {len(text)} characters, more than {limit}")


ANY_VEHICLE = "vehicle"
"""Category of a target that is a car, van, truck or bus."""
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
_TEXTS = ("name", "arm", "track_id", "category", "motion", "setting", "planner", "cut_reason")
_LONGEST_TEXT = 4000
"""Names are shorter (`NAME_LIMIT`); a rollout's joins two, and a reason may quote some."""


@dataclass(frozen=True, repr=False)
class Rollout(Brief):
    """One closed-loop rollout of S executed steps, with states k = 0..S and C plans.

    Attributes:
        name: name of the rollout, unique within a batch.
        arm: what rendered the actor ("native", "recast", ...); the states of a scripted actor do
            not depend on it.
        track_id: the target, the first controlled actor.
        category: category of the target, see `Track.category`; "vehicle" for "car", "van", "truck"
            and "bus".
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
        other_actors: ids of those of `controlled` that no scenario moves: the log's traffic, see
            `recast.simulation.traffic`.
        controlled: controlled actors beside the target in order, then the traffic.
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
    category: str = ANY_VEHICLE
    other_actors: tuple[str, ...] = ()
    controlled: tuple[ControlledActor, ...] = ()
    reactive: tuple[str, ...] = ()
    origin: RolloutOrigin | None = field(default=None, compare=False)

    def _facts(self) -> Mapping[str, object]:
        return {
            "name": self.name,
            "planner": self.planner,
            "arm": self.arm,
            "steps": f"{self.steps_run} of {self.steps_requested}",
            "cut": self.cut_reason or "no",
        }

    def __getstate__(self) -> dict[str, Any]:
        # Another process neither needs the log nor can use the renderer.
        return {**self.__dict__, "origin": None}

    @property
    def noun(self) -> str:
        """What the target is called in sentences: pedestrian, cyclist or vehicle."""
        return self.category if self.category in PEOPLE else ANY_VEHICLE

    @property
    def further(self) -> tuple[ControlledActor, ...]:
        """The scenario's controlled actors beside the target."""
        return tuple(one for one in self.controlled if one.track_id not in self.other_actors)

    @property
    def traffic(self) -> tuple[ControlledActor, ...]:
        """Road users that no scenario moves."""
        return tuple(one for one in self.controlled if one.track_id in self.other_actors)

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

    def state(self, step: int) -> SimState:
        """The world at a step, to be rendered again."""
        return SimState(
            step=step,
            timestamp_us=self.timestamp_us(step),
            ego=EgoState(self.ego[step]),
            log_ego=self.log_ego[step],
            world_from_rig=self.world_from_rig[step],
            track_id=self.track_id,
            actor=self.actor[step],
            world_from_actor=self.world_from_actor[step],
            others={one.track_id: one.world_from_actor[step] for one in self.traffic},
            further={
                one.track_id: SimActor(one.states[step], one.world_from_actor[step])
                for one in self.further
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
