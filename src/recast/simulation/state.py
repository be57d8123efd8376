"""What is simulated: the world at one step, and a further actor over all the steps of a rollout."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field, replace
from typing import TYPE_CHECKING

import numpy as np

from recast.arrays import Array, Int64Array
from recast.dynamics import EgoState
from recast.logs.checks import BOX_SIDE, NAME_LIMIT, WORLD_REACH, check_poses, check_text

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
        others: `world_from_actor` (4, 4) by track id, of logged actors that stay in the scene.
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
