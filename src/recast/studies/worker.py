"""What a worker does with the tasks of a grid, and how they and their artefacts come to it."""

from __future__ import annotations

import logging
import time
from collections.abc import Callable
from dataclasses import replace
from functools import cached_property
from pathlib import Path
from typing import Any, Protocol

from recast.core import Artefact, Store, open_store
from recast.core.ray_cluster import fetch_parcel, node_folder, send_parcel, worker_pool
from recast.core.remote import Fetch, ParcelDepot, pack
from recast.core.store import NotInStoreError
from recast.runs.layout import STORE_FOLDER
from recast.runs.rollouts import is_failure
from recast.runs.sources import Sources
from recast.simulation import Timings, error_fields
from recast.studies.grid import BenchSettings
from recast.studies.scene_run import (
    GridTask,
    RolloutTask,
    RolloutTimes,
    SceneOutcome,
    SceneRun,
    log_artefact,
)

_LOG = logging.getLogger(__name__)

_FINISHED = "finished artefacts"


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
    """Does tasks one after the other, and keeps the scene of the last open.

    Whatever a task raises is its outcome: no scene and no planner ends the grid.

    Args:
        retry_failures: run rollouts again that failed in an earlier try.
        fetch: function that gets the artefacts that come with a task, see `ParcelDepot`.
    """

    def __init__(
        self, store: Store, settings: BenchSettings, retry_failures: bool, fetch: Fetch | None
    ) -> None:
        self._store, self._settings, self._retry = store, settings, retry_failures
        self._fetch = fetch
        self._open: tuple[str, SceneRun] | None = None

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
        if self._open is None or self._open[0] != task.scene.id:
            self.close()
            log = None
            if task.log is not None:
                log = self._store.open(task.log)
            elif task.scene.log is None:
                log = log_artefact(self._store, task.scene, self._settings)
            run = SceneRun(self._store, task.scene, self._settings, log, self._sources)
            self._open = task.scene.id, run
        return self._open[1]

    def close(self) -> None:
        """Let go of the scene."""
        if self._open is not None:
            self._open[1].artefacts.close()
            self._open = None

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
