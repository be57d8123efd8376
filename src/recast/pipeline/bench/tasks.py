"""The pieces of work of a grid, and what comes of one."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field

from recast.pipeline.artefacts import rollout_name
from recast.pipeline.bench.scenes import BenchScene


@dataclass(frozen=True)
class Task:
    """A piece of work on a scene.

    Attributes:
        scene: which.
        log: reference of its log in the store; None while there is none, or where it lies in a
            folder of its own.
        tickets: of the artefacts that it needs, where workers share no folder with this process.
    """

    scene: BenchScene
    log: str | None = None
    tickets: Mapping[str, object] = field(default_factory=dict)


@dataclass(frozen=True)
class SceneTask(Task):
    """From nothing to log, streets and vehicles, as far as the rollouts need them."""


@dataclass(frozen=True)
class RolloutTask(Task):
    """One rollout of a scene that is there."""

    motion: str = ""
    planner: str = ""
    arm: str = ""

    @property
    def use(self) -> str:
        """What the run of the scene calls the rollout."""
        return rollout_name(self.motion, self.planner, self.arm)


@dataclass(frozen=True)
class RolloutTimes:
    """Wall-clock seconds of a rollout that was made now.

    Attributes:
        render, plan, control: see `recast.simulation.Timings`.
        total: of everything, loading and writing included.
        frames: rendered.
    """

    render: float
    plan: float
    control: float
    total: float
    frames: int


@dataclass(frozen=True)
class Outcome:
    """What came of a task.

    Attributes:
        used: references of the artefacts by use, see `Artefacts.used`.
        log: reference of the log in the store, if it lies there.
        error, reason, traceback: of what the task raised; None if it is done.
        times: of a rollout that was made now.
        parcels: artefacts that were made, by reference, where no folder is shared.
    """

    used: Mapping[str, str] = field(default_factory=dict)
    log: str | None = None
    error: str | None = None
    reason: str | None = None
    traceback: str | None = None
    times: RolloutTimes | None = None
    parcels: Mapping[str, bytes] = field(default_factory=dict)
