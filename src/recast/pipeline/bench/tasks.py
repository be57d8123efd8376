"""The pieces of work of a grid, and what comes of one."""

from __future__ import annotations

from dataclasses import dataclass

from recast.evaluation.grid_row import GridRow
from recast.pipeline.bench.scenes import BenchScene
from recast.pipeline.layout import Method


@dataclass(frozen=True)
class Task:
    """A piece of work on a scene."""

    scene: BenchScene


@dataclass(frozen=True)
class SceneTask(Task):
    """From nothing to log, actor and trained scene, as far as the rollouts need them."""


@dataclass(frozen=True)
class RolloutTask(Task):
    """One rollout of a scene that is there."""

    motion: str
    method: Method

    @property
    def key(self) -> str:
        """Its name in times.json and, below the scene's run, of its folder."""
        return f"{self.scene.id}/{self.motion}/{self.method}"


@dataclass(frozen=True)
class ScoreTask(Task):
    """metrics.json of a scene whose rollouts are all made.

    Attributes:
        rollouts: by MOTION/METHOD, the hash of each, see `Job.make_rollout`.
    """

    rollouts: tuple[tuple[str, str], ...]


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
        error, reason: class and message of what it raised; None if it is done.
        hash: of a rollout.
        times: of a rollout that was made now.
        rows: of a score.
    """

    error: str | None = None
    reason: str | None = None
    hash: str = ""
    times: RolloutTimes | None = None
    rows: tuple[GridRow, ...] = ()
