"""Brings tasks to workers, and artefacts to those that share no folder with this process."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace
from typing import Any, Protocol

from recast.core import Store
from recast.core.parcel import pack
from recast.core.store import NotInStoreError
from recast.crews import Crew
from recast.crews.ray_cluster import fetch_parcel, send_parcel
from recast.pipeline.bench.scene_run import log_artefact
from recast.pipeline.bench.settings import BenchSettings
from recast.pipeline.bench.tasks import Outcome, Task
from recast.pipeline.bench.worker import BenchWorker

_FINISHED = "finished artefacts"


class Courier:
    """Puts each artefact into Ray's object store once, for all tasks that need it.

    Args:
        store: of this process.
        settings: of the grid.
        worker: makes a worker of a store, which is asked what earlier tries have made.
    """

    fetch = staticmethod(fetch_parcel)

    def __init__(
        self, store: Store, settings: BenchSettings, worker: Callable[[Store], BenchWorker]
    ) -> None:
        self._store, self._settings = store, settings
        self._sent: dict[str, object] = {}
        self._finder = worker(Store(store.root, store.depot, only_finds=True))

    def loaded(self, task: Task, names: tuple[str, ...]) -> Task:
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

    def found(self, task: Task) -> Outcome | None:
        """The outcome of a task of which an earlier try made everything; else None."""
        outcome = self._finder(task)
        return None if outcome.error == NotInStoreError.__name__ else outcome

    def unload(self, outcome: Outcome) -> None:
        """Take what a worker made into the store."""
        for name, parcel in outcome.parcels.items():
            self._store.take(name, parcel)


class TaskList(Protocol):
    """The tasks of an experiment that are ready."""

    def take(self) -> Task | None:
        """The next task, or None where there is none now."""

    def needed(self, task: Task) -> tuple[str, ...]:
        """References of the artefacts that a task needs."""


def work_off(
    crew: Crew,
    start: Any,
    arguments: tuple[Any, ...],
    tasks: TaskList,
    courier: Courier | None,
    done: Callable[[Task, Outcome], None],
) -> None:
    """Have a crew do all tasks.

    Args:
        start, arguments: of the crew's workers.
        courier: where workers share no folder with this process.
        done: told what came of each task, which may make others ready.
    """

    def take() -> Task | None:
        while (task := tasks.take()) is not None and courier is not None:
            found = courier.found(task)
            if found is None:
                return courier.loaded(task, tasks.needed(task))
            done(task, found)
        return task

    for task, outcome in crew(start, arguments, take, _FINISHED):
        if courier is not None:
            courier.unload(outcome)
        done(task, outcome)
