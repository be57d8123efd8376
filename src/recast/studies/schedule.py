"""What this process does for a grid: which task comes when, each scene's folder, and the times.

Times are kept apart from the results, which are the same every time.
"""

from __future__ import annotations

from collections import deque
from collections.abc import Callable, Iterable, Mapping, Sequence
from contextlib import suppress
from itertools import product
from pathlib import Path
from typing import Any, Literal

from pydantic import BaseModel, ConfigDict, NonNegativeFloat, NonNegativeInt

from recast.core import Store, files
from recast.core.errors import InputError
from recast.core.records import read_record
from recast.runs.layout import METRICS_FILE, use_parts
from recast.runs.run_folder import RunFolder
from recast.runs.scores import read_metrics, write_metrics
from recast.runs.trust import RunTrust
from recast.studies.grid import SCENES_FOLDER, TIMES_FILE, BenchSettings
from recast.studies.grid_rows import GridRow
from recast.studies.scene_run import (
    GridTask,
    RolloutTask,
    RolloutTimes,
    SceneOutcome,
    SceneTask,
    blank_row,
    open_scene,
    scene_rows,
)

Cell = tuple[str, str, str]
"""Motion, planner and arm of a rollout."""

FAILURE_FILE = "failure.json"
"""What ended a scene's last try, with its traceback; gone when the scene is made."""
SCENE_PARTS = ("scene/", "evaluation/", "registered/", "actor/")
PARTS = ("render", "plan", "control", "rest")
TIMES_VERSION: Literal[2] = 2


class SceneDesk:
    """Writes OUT/scenes/ID of every scene.

    Args:
        names: planners' names in results, by the word that asks for them.
    """

    def __init__(
        self, settings: BenchSettings, out: Path, store: Store, names: Mapping[str, str]
    ) -> None:
        self._settings, self._out, self._store, self._names = settings, out, store, names
        self.seconds: dict[str, dict[str, float]] = {}
        """By scene, what its artefacts took, whichever grid made them."""

    def note(self, task: GridTask, outcome: SceneOutcome) -> None:
        """Keep the traceback of a task that failed; forget that of an earlier try."""
        path = self._out / SCENES_FOLDER / f"{task.scene.id}.{FAILURE_FILE}"
        with suppress(InputError):  # the disk may be what failed
            if outcome.error is not None:
                fault = {"error": outcome.error, "reason": outcome.reason}
                files.write_json(path, {**fault, "traceback": outcome.traceback})
            elif not isinstance(task, RolloutTask):
                path.unlink(missing_ok=True)

    def score(
        self, scene_id: str, used: dict[str, str], log: str | None, errors: dict[str, SceneOutcome]
    ) -> list[GridRow]:
        """Write the run folder of a scene whose rollouts are all made; return its rows."""
        scene = next(one for one in self._settings.scenes if one.id == scene_id)
        artefacts = {use: self._store.open(name) for use, name in used.items() if use != "log"}
        kept = {} if log is None else {"log": self._store.open(log)}
        source, config = open_scene(scene, self._settings, kept.get("log"))
        out = self._out / SCENES_FOLDER / scene.id
        folder = RunFolder.create_or_resume(
            out, config.resolved(), source.path, source.hash, str(self._store.root)
        )
        folder.refer(self._store, {**kept, **artefacts}, whole=True)
        trust = RunTrust(source.log, config.track)
        write_metrics(out / METRICS_FILE, config, artefacts, source.map, trust)
        self.seconds[scene.id] = {
            use: one.record.seconds
            for use, one in sorted(artefacts.items())
            if use.startswith(SCENE_PARTS)
        }
        metrics = read_metrics(out / METRICS_FILE)
        return scene_rows(scene, config, source.log.name, self._names, metrics, artefacts, errors)


class Schedule:
    """The tasks of a grid that are ready, and what came of them.

    Scenes go first, since they take longest and make work for the others.

    Args:
        names: planners' names in results, by the word that asks for them.
        score: function that gives the rows of a scene whose tasks are all done, from its id, the
            references of its artefacts by use, its log, and the errors of rollouts that could not
            begin.
    """

    def __init__(
        self,
        settings: BenchSettings,
        names: Mapping[str, str],
        score: Callable[[str, dict[str, str], str | None, dict[str, SceneOutcome]], list[GridRow]],
    ) -> None:
        self._settings, self._names, self._score = settings, names, score
        self._ready: deque[GridTask] = deque(SceneTask(scene) for scene in settings.scenes)
        run = settings.run
        arms = [arm.name for arm in run.arms]
        self._cells: list[Cell] = list(product(run.motions, run.planners, arms))
        self._used: dict[str, dict[str, str]] = {scene.id: {} for scene in settings.scenes}
        self._errors: dict[str, dict[str, SceneOutcome]] = {
            scene.id: {} for scene in settings.scenes
        }
        self._left = {scene.id: len(self._cells) for scene in settings.scenes}
        self._rows: dict[str, list[GridRow]] = {}
        self.done = 0
        self.total = len(settings.scenes) * (1 + len(self._cells))

    def take(self) -> GridTask | None:
        """The next task, or None where there is none now."""
        return self._ready.popleft() if self._ready else None

    def note(self, task: GridTask, outcome: SceneOutcome) -> None:
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

    def needed(self, task: GridTask) -> tuple[str, ...]:
        """References of what the scene of a task has so far, but for rollouts."""
        used = self._used[task.scene.id].values()
        return tuple(dict.fromkeys(one for one in used if not one.startswith("rollouts/")))

    def rows(self) -> list[GridRow]:
        """All rows in the order of the grid, once nothing is left to do."""
        return [row for scene in self._settings.scenes for row in self._rows[scene.id]]

    def _failed(self, task: GridTask, outcome: SceneOutcome) -> list[GridRow]:
        error, reason = outcome.error or "Error", outcome.reason or ""
        return [
            blank_row(task.scene, self._settings.run, motion, self._names[planner], arm).failed(
                error, reason
            )
            for motion, planner, arm in self._cells
        ]


class _Session(BaseModel):
    model_config = ConfigDict(extra="forbid", allow_inf_nan=False)

    workers: NonNegativeInt
    seconds: NonNegativeFloat = 0.0
    rollouts: NonNegativeInt = 0


class _Earlier(BaseModel):
    """What is kept of an earlier times.json; the sums are made anew."""

    model_config = ConfigDict(allow_inf_nan=False)

    rollouts: dict[str, RolloutTimes] = {}
    sessions: list[_Session] = []


class Times:
    """times.json: seconds of every rollout, of every scene's preparation, and of every session.

    Args:
        out: folder of the grid; what earlier sessions took is kept.

    Raises:
        InputError: the file of the earlier sessions is damaged.
    """

    def __init__(self, out: Path, workers: int) -> None:
        self._path, before = out / TIMES_FILE, _Earlier()
        if self._path.is_file():
            before = read_record(self._path, _Earlier, TIMES_VERSION, "delete it")
        self._rollouts, self._sessions = before.rollouts, before.sessions
        self._session = _Session(workers=workers)

    def note(self, task: RolloutTask, times: RolloutTimes, seconds: float) -> None:
        """A rollout was made, `seconds` after the session began."""
        self._rollouts[f"{task.scene.id}/{task.use}"] = times
        self._session.rollouts += 1
        self.write(seconds)

    def write(
        self,
        seconds: float,
        settings: BenchSettings | None = None,
        scenes: Mapping[str, Mapping[str, float]] | None = None,
    ) -> dict[str, Any]:
        """Write the file, with sums where the grid is finished; return its content.

        Args:
            scenes: seconds that the artefacts of a scene took, by scene.
        """
        self._session.seconds = round(seconds, 2)
        sessions = [session.model_dump() for session in (*self._sessions, self._session)]
        value: dict[str, Any] = {"version": TIMES_VERSION, "sessions": sessions}
        if settings is not None:
            value |= {**self._sums(settings), "scenes": scenes or {}}
        value["rollouts"] = {
            key: {name: round(one, 4) for name, one in vars(times).items()}
            for key, times in sorted(self._rollouts.items())
        }
        files.write_json(self._path, value)
        return value

    def _sums(self, settings: BenchSettings) -> dict[str, Any]:
        by_arm = {
            arm.name: _sum(v for k, v in self._rollouts.items() if use_parts(k)[-1] == arm.name)
            for arm in settings.run.arms
        }
        return {"all": _sum(self._rollouts.values()), "arms": by_arm}


def _sum(rollouts: Iterable[RolloutTimes]) -> dict[str, Any]:
    """Seconds by part, their shares of the whole, and how many rollouts they are of."""
    rows: Sequence[RolloutTimes] = list(rollouts)
    total = sum(row.total for row in rows)
    seconds = {name: sum(getattr(row, name) for row in rows) for name in PARTS if name != "rest"}
    seconds["rest"] = total - sum(seconds.values())
    return {
        "rollouts": len(rows),
        "seconds": round(total, 2),
        "frames": sum(row.frames for row in rows),
        "parts": {name: round(seconds[name], 2) for name in PARTS},
        "shares": {name: round(seconds[name] / total, 4) if total else None for name in PARTS},
    }
