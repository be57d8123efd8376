"""One moment of a rollout: what is simulated and what the log did, side by side."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field

import numpy as np
from numpy.typing import NDArray

from recast.dynamics import EgoState

Array = NDArray[np.float64]


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
