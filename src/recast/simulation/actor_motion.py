"""The seam between the simulator and what controlled actors do."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Protocol, TypeGuard

from recast.arrays import Array
from recast.planning import ActorState
from recast.simulation.situation import StartSituation


@dataclass(frozen=True)
class MotionInput:
    """What a motion sees at one step.

    Attributes:
        situation: where everything was at the start.
        step: of `state`, 0 at the start.
        steps: how many steps the rollout was asked for.
        state: (4,) x, y, heading of the actor's box centre, speed; world, SI units.
        ego: the ego now, its box and velocity; its `track_id` is "ego".
        others: the other road users now: controlled actors in their order, then logged ones.
    """

    situation: StartSituation
    step: int
    steps: int
    state: Array
    ego: ActorState
    others: tuple[ActorState, ...] = ()

    @property
    def road_users(self) -> tuple[ActorState, ...]:
        """The ego and the others."""
        return (self.ego, *self.others)


class ActorMotion(Protocol):
    """Moves a controlled actor step by step. Implement this for a motion that reacts.

    States are (4,): x, y, heading of the box centre in the world, speed >= 0; SI units.

    It may also have `follows_log`, true if the actor stays on its own logged path: the rollout is
    then not cut where that path leaves the ego's recorded road.

    Attributes:
        name: for tables and file names, such as "idm".
        setting: which parameters, such as "a".
    """

    @property
    def name(self) -> str:
        """Name of the motion."""

    @property
    def setting(self) -> str:
        """Name of the setting."""

    def start(self, situation: StartSituation) -> Array:
        """The state (4,) at the start."""

    def step(self, state: MotionInput, dt: float) -> Array:
        """The state (4,) `dt` seconds after `state`."""


class ScriptMotion(Protocol):
    """A motion that is known at the start, since it does not react.

    Attributes:
        name: for tables and file names, such as "cut-in".
        setting: which parameters, such as "a".
    """

    @property
    def name(self) -> str:
        """Name of the motion."""

    @property
    def setting(self) -> str:
        """Name of the setting."""

    def script(self, start: StartSituation, steps: int, dt: float) -> Array:
        """States (steps + 1, 4): x, y, heading of the box centre, speed >= 0; world, SI units."""


class Scripted:
    """Base of scripted motions: `start` and `step` give what `script` says."""

    def start(self, situation: StartSituation) -> Array:
        """The first state (4,) of the script."""
        first: Array = self.script(situation, 1, 0.1)[0]
        return first

    def step(self, state: MotionInput, dt: float) -> Array:
        """The state (4,) after `state.step`, whatever the others do."""
        following: Array = self.script(state.situation, state.steps, dt)[state.step + 1]
        return following

    def script(self, start: StartSituation, steps: int, dt: float) -> Array:
        """States (steps + 1, 4), see `ScriptMotion`."""
        raise NotImplementedError


AnyMotion = ActorMotion | ScriptMotion
"""What a controlled actor may be given."""


def is_scripted(motion: object) -> TypeGuard[ScriptMotion]:
    """Whether a motion is known at the start."""
    return callable(getattr(motion, "script", None))


def is_motion(value: object) -> TypeGuard[AnyMotion]:
    """Whether a value has what a motion needs."""
    named = all(isinstance(getattr(value, name, None), str) for name in ("name", "setting"))
    steps = all(callable(getattr(value, name, None)) for name in ("start", "step"))
    return named and (steps or is_scripted(value))


def follows_log(motion: object) -> bool:
    """Whether a motion stays on the actor's own logged path."""
    return bool(getattr(motion, "follows_log", False))
