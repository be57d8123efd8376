"""What is done for a grid: which task comes when, and the workers that do them.

Artefacts come to the workers and from them; this process writes each scene's folder, and the times.
Times are kept apart from the results, which are the same every time."""

from __future__ import annotations

import logging
import time
from collections import deque
from collections.abc import Callable, Iterable, Mapping, Sequence
from contextlib import suppress
from dataclasses import replace
from functools import cached_property
from itertools import product
from pathlib import Path
from typing import Any, Literal, Protocol

from pydantic import BaseModel, ConfigDict, NonNegativeFloat, NonNegativeInt

from recast.core import Artefact, Store, files, open_store
from recast.core.artefact import Fetch, ParcelDepot, pack
from recast.core.errors import InputError
from recast.core.records import read_record
from recast.core.store import NotInStoreError
from recast.core.workers import fetch_parcel, node_folder, send_parcel, worker_pool
from recast.runs.rollouts import is_failure
from recast.runs.run_folder import METRICS_FILE, STORE_FOLDER, RunFolder, use_parts
from recast.runs.scores import RunTrust, read_metrics, write_metrics
from recast.runs.sources import Sources
from recast.simulation import Timings, error_fields
from recast.studies.grid import SCENES_FOLDER, TIMES_FILE, BenchSettings, GridRow
from recast.studies.scene_run import (
    GridTask,
    RolloutTask,
    RolloutTimes,
    SceneOutcome,
    SceneRun,
    SceneTask,
    blank_row,
    log_artefact,
    open_scene,
    scene_rows,
)

_LOG = logging.getLogger(__name__)

_FINISHED = "finished artefacts"
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


def _start(
    number: int,
    place: str | None,
    kind: Callable[..., BenchWorker],
    arguments: tuple[Any, ...],
    fetch: Fetch | None,
) -> BenchWorker:
    """A worker of a pool; `place` is None for the store of each machine of a cluster."""
    del number  # makes no difference
    from recast.splats import set_threads

    set_threads(1)
    return kind(open_store(node_folder() if place is None else place), *arguments, fetch)


class BenchWorker:
    """Does tasks one after the other, and keeps the scenes of the last ones open, `kept` of them.

    Whatever a task raises is its outcome: no scene and no planner ends the grid.

    Args:
        retry_failures: run rollouts again that failed in an earlier try.
        fetch: function that gets the artefacts that come with a task, see `ParcelDepot`.
    """

    kept = 1

    def __init__(
        self, store: Store, settings: BenchSettings, retry_failures: bool, fetch: Fetch | None
    ) -> None:
        self._store, self._settings, self._retry = store, settings, retry_failures
        self._fetch = fetch
        self._open: dict[str, SceneRun] = {}

    @cached_property
    def _sources(self) -> Sources:
        """Those of the grid; a planner that is another program may be away for a while.

        Taken for the first task before anything of them is loaded: what is edited later is used by
        the next grid.
        """
        return Sources.of(self._settings.run, self._settings.scenes[0].id)

    def __call__(self, task: GridTask) -> SceneOutcome:
        """The task's outcome."""
        if self._fetch is not None:
            self._store.depot = ParcelDepot(task.tickets, self._fetch)
        try:
            return self._outcome(task, self._do(task, self._scene_run(task)))
        except Exception as error:
            _LOG.warning("%s of %s failed", type(task).__name__, task.scene.id, exc_info=True)
            fault = error_fields(error)
            return SceneOutcome(
                error=fault["error"], reason=fault["reason"], traceback=fault["traceback"]
            )

    def _do(self, task: GridTask, run: SceneRun) -> RolloutTimes | None:
        """Make what a task is for, on its opened scene."""
        if isinstance(task, RolloutTask):
            return self._make_rollout(task, run)
        run.prepare()
        return None

    def _outcome(self, task: GridTask, times: RolloutTimes | None) -> SceneOutcome:
        run = self._scene_run(task)
        used = run.artefacts.used
        parcels = {}
        if self._fetch is not None:
            parcels = {
                one.reference: pack(one)
                for one in used.values()
                if one.reference not in task.tickets and self._is_new(task, one)
            }
        log = None if run.log is None else run.log.reference
        return SceneOutcome(used=run.used(), log=log, times=times, parcels=parcels)

    def _is_new(self, task: GridTask, artefact: Artefact) -> bool:
        """A rollout's outcome brings that rollout; a scene's brings all else."""
        return (artefact.record.kind == "rollouts") == isinstance(task, RolloutTask)

    def _scene_run(self, task: GridTask) -> SceneRun:
        found = self._open.pop(task.scene.id, None)
        if found is None:
            while len(self._open) >= self.kept:
                self._open.pop(next(iter(self._open))).artefacts.close()
            log = None
            if task.log is not None:
                log = self._store.open(task.log)
            elif task.scene.log is None:
                log = log_artefact(self._store, task.scene, self._settings)
            found = SceneRun(self._store, task.scene, self._settings, log, self._sources)
        self._open[task.scene.id] = found  # the last one used is the last one let go of
        return found

    def close(self) -> None:
        """Let go of the scenes."""
        while self._open:
            self._open.popitem()[1].artefacts.close()

    def _make_rollout(self, task: RolloutTask, run: SceneRun) -> RolloutTimes | None:
        timings, began = Timings(), time.perf_counter()
        artefacts = run.artefacts
        arm = artefacts.arms[task.arm]
        for use in [use for use in artefacts.used if use.startswith("rollout/")]:
            del artefacts.used[use]  # of the tasks before
        found = artefacts.rollout(task.motion, task.planner, arm, timings)
        if self._retry and not found.fresh and is_failure(found.path):
            del artefacts.used[task.use]
            self._store.remove(found)
            found = artefacts.rollout(task.motion, task.planner, arm, timings)
        if not found.fresh or timings.plan == 0.0:  # refused before the first plan
            return None
        total = time.perf_counter() - began
        return RolloutTimes(timings.render, timings.plan, timings.control, total, timings.frames)


class Courier:
    """Puts each artefact into Ray's object store once, for all tasks that need it.

    Args:
        worker: function that makes a worker of a store, which is asked what earlier tries
            have made.
    """

    fetch = staticmethod(fetch_parcel)

    def __init__(
        self, store: Store, settings: BenchSettings, worker: Callable[[Store], BenchWorker]
    ) -> None:
        self._store, self._settings = store, settings
        self._sent: dict[str, object] = {}
        self._finder = worker(Store(store.root, store.depot, only_finds=True))

    def loaded(self, task: GridTask, names: tuple[str, ...]) -> GridTask:
        """The task with its log and with a ticket for every artefact that it needs.

        Args:
            names: references of what the scene has so far.
        """
        if task.scene.log is not None and task.log is None:
            log = log_artefact(self._store, task.scene, self._settings).reference
            task = replace(task, log=log)
        needed = dict.fromkeys((*names, *(() if task.log is None else (task.log,))))
        for name in needed:
            if name not in self._sent:
                self._sent[name] = send_parcel(pack(self._store.open(name)))
        return replace(task, tickets={name: self._sent[name] for name in needed})

    def found(self, task: GridTask) -> SceneOutcome | None:
        """The outcome of a task of which an earlier try made everything; else None."""
        outcome = self._finder(task)
        return None if outcome.error == NotInStoreError.__name__ else outcome

    def unload(self, outcome: SceneOutcome) -> None:
        """Take what a worker made into the store."""
        for name, parcel in outcome.parcels.items():
            self._store.take(name, parcel)


class TaskList(Protocol):
    """The tasks of an experiment that are ready."""

    def take(self) -> GridTask | None:
        """The next task, or None where there is none now."""

    def needed(self, task: GridTask) -> tuple[str, ...]:
        """References of the artefacts that a task needs."""


class Workers:
    """The workers of an experiment, and the store that they fill.

    Args:
        workers: number of processes of this machine, or of actors of the cluster.
        ray: address of a Ray cluster, whose machines share no folder; None for none.
        store: folder or address of the artefacts; beside `out` if None.

    Raises:
        InputError: see `worker_pool` and `open_store`.
    """

    def __init__(self, out: Path, workers: int, ray: str | None, store: str | Path | None) -> None:
        self._pool = worker_pool(workers, ray)
        place = str(out.absolute().parent / STORE_FOLDER if store is None else store)
        self.store = open_store(place)
        self._place = place if ray is None else None

    def do(
        self,
        kind: Callable[..., BenchWorker],
        arguments: tuple[Any, ...],
        settings: BenchSettings,
        tasks: TaskList,
        done: Callable[[GridTask, SceneOutcome], None],
    ) -> None:
        """Do all tasks.

        Args:
            kind: function that makes a worker from its store, `arguments`, and what fetches
                parcels, if any.
            done: function that is told what came of each task, which may make others ready.
        """
        courier = None
        if self._place is None:
            courier = Courier(self.store, settings, lambda finds: kind(finds, *arguments, None))

        def take() -> GridTask | None:
            while (task := tasks.take()) is not None and courier is not None:
                found = courier.found(task)
                if found is None:
                    return courier.loaded(task, tasks.needed(task))
                done(task, found)
            return task

        given = (self._place, kind, arguments, None if courier is None else courier.fetch)
        for task, outcome in self._pool(_start, given, take, _FINISHED):
            if courier is not None:
                courier.unload(outcome)
            done(task, outcome)
