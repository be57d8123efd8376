"""What the controlled actors will do before anything runs."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from recast.dynamics import state as ego
from recast.planning import ReferenceRoute
from recast.simulation.controlled_actors import ControlledActors
from recast.simulation.lift import RoadSurface
from recast.simulation.recorded_road import refuse_if_too_short
from recast.simulation.rollout_start import RolloutStart, start_rollout
from recast.simulation.setup import RolloutSetup

Array = NDArray[np.float64]


@dataclass(frozen=True)
class PreparedActor:
    """A further controlled actor as it will move.

    Attributes:
        track_id: of the log.
        states: (S+1, 4) x, y, heading of the box centre, speed.
        world_from_actor: (S+1, 4, 4).
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
        world_from_actor: (S+1, 4, 4).
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
    if actors.react:
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
        ego=start.ego[0],
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
