"""Which task comes when: scenes first, their rollouts as soon as they can be, scores last."""

from __future__ import annotations

from collections import deque

from recast.evaluation.grid_row import GridRow
from recast.pipeline.bench.score import blank_row
from recast.pipeline.bench.settings import BenchSettings
from recast.pipeline.bench.tasks import Outcome, RolloutTask, SceneTask, ScoreTask, Task


class Schedule:
    """The tasks of a grid that are ready, and the rows that came of them.

    Scenes go first, since they take longest and make work for the others.

    Args:
        settings: of the grid.
        planner: its name, for rows of scenes that fail.
    """

    def __init__(self, settings: BenchSettings, planner: str) -> None:
        self._settings, self._planner = settings, planner
        self._ready: deque[Task] = deque(SceneTask(scene) for scene in settings.scenes)
        self._hashes: dict[str, dict[str, str]] = {scene.id: {} for scene in settings.scenes}
        self._rows: dict[str, tuple[GridRow, ...]] = {}
        self._cells = [(m, n) for m in settings.run.motions for n in settings.run.methods]
        self.done = 0
        self.total = len(settings.scenes) * (1 + len(self._cells))

    def take(self) -> Task | None:
        """The next task, or None where there is none now."""
        return self._ready.popleft() if self._ready else None

    def note(self, task: Task, outcome: Outcome) -> None:
        """A task is done: what it makes possible becomes ready."""
        scene = task.scene
        if isinstance(task, ScoreTask) or (outcome.error and isinstance(task, SceneTask)):
            if isinstance(task, SceneTask):
                self.done += 1 + len(self._cells)
            self._rows[scene.id] = outcome.rows or self._failed(task, outcome)
            return
        self.done += 1
        if isinstance(task, SceneTask):
            self._ready.extend(RolloutTask(scene, *cell) for cell in self._cells)
            return
        assert isinstance(task, RolloutTask)
        hashes = self._hashes[scene.id]
        hashes[f"{task.motion}/{task.method}"] = outcome.hash
        if len(hashes) == len(self._cells):
            ordered = tuple((key, hashes[key]) for key in (f"{m}/{n}" for m, n in self._cells))
            self._ready.append(ScoreTask(scene, ordered))

    def rows(self) -> list[GridRow]:
        """All rows in the order of the grid, once nothing is left to do."""
        return [row for scene in self._settings.scenes for row in self._rows[scene.id]]

    def _failed(self, task: Task, outcome: Outcome) -> tuple[GridRow, ...]:
        error, reason = outcome.error or "Error", outcome.reason or ""
        return tuple(
            blank_row(
                task.scene, self._settings.run, motion, method, self._planner
            ).failed(error, reason)
            for motion, method in self._cells
        )  # fmt: skip
