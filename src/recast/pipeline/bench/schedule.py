"""Which task comes when: scenes first, their rollouts as soon as they can be."""

from __future__ import annotations

from collections import deque
from collections.abc import Callable, Mapping

from recast.evaluation.grid_row import GridRow
from recast.pipeline.bench.score import blank_row
from recast.pipeline.bench.settings import BenchSettings
from recast.pipeline.bench.tasks import Outcome, RolloutTask, SceneTask, Task

Cell = tuple[str, str, str]
"""Motion, planner and arm of a rollout."""


class Schedule:
    """The tasks of a grid that are ready, and what came of them.

    Scenes go first, since they take longest and make work for the others.

    Args:
        settings: of the grid.
        names: planners' names in results, by the word that asks for them.
        score: gives the rows of a scene whose tasks are all done, from its id, the references of
            its artefacts by use, its log, and the errors of rollouts that could not begin.
    """

    def __init__(
        self,
        settings: BenchSettings,
        names: Mapping[str, str],
        score: Callable[[str, dict[str, str], str | None, dict[str, Outcome]], list[GridRow]],
    ) -> None:
        self._settings, self._names, self._score = settings, names, score
        self._ready: deque[Task] = deque(SceneTask(scene) for scene in settings.scenes)
        run = settings.run
        self._cells: list[Cell] = [
            (motion, planner, arm.name)
            for motion in run.motions
            for planner in run.planners
            for arm in run.arms
        ]
        self._used: dict[str, dict[str, str]] = {scene.id: {} for scene in settings.scenes}
        self._errors: dict[str, dict[str, Outcome]] = {scene.id: {} for scene in settings.scenes}
        self._left = {scene.id: len(self._cells) for scene in settings.scenes}
        self._rows: dict[str, list[GridRow]] = {}
        self.done = 0
        self.total = len(settings.scenes) * (1 + len(self._cells))

    def take(self) -> Task | None:
        """The next task, or None where there is none now."""
        return self._ready.popleft() if self._ready else None

    def note(self, task: Task, outcome: Outcome) -> None:
        """A task is done: what it makes possible becomes ready."""
        scene = task.scene
        self.done += 1
        self._used[scene.id] |= outcome.used
        if isinstance(task, RolloutTask):
            if outcome.error is not None:
                self._errors[scene.id][task.use] = outcome
            self._left[scene.id] -= 1
            if self._left[scene.id] == 0:
                self._rows[scene.id] = self._score(
                    scene.id, self._used[scene.id], task.log, self._errors[scene.id]
                )
        elif outcome.error is not None:
            self.done += len(self._cells)
            self._rows[scene.id] = self._failed(task, outcome)
        else:
            ready = [
                RolloutTask(scene, outcome.log, {}, motion, planner, arm)
                for motion, planner, arm in self._cells
            ]
            self._ready.extend(ready)

    def needed(self, task: Task) -> tuple[str, ...]:
        """References of what the scene of a task has so far, but for rollouts."""
        used = self._used[task.scene.id].values()
        return tuple(dict.fromkeys(one for one in used if not one.startswith("rollouts/")))

    def rows(self) -> list[GridRow]:
        """All rows in the order of the grid, once nothing is left to do."""
        return [row for scene in self._settings.scenes for row in self._rows[scene.id]]

    def _failed(self, task: Task, outcome: Outcome) -> list[GridRow]:
        error, reason = outcome.error or "Error", outcome.reason or ""
        return [
            blank_row(
                task.scene, self._settings.run, motion, self._names[planner], arm
            ).failed(error, reason)
            for motion, planner, arm in self._cells
        ]  # fmt: skip
