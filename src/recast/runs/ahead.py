"""A second process of a run: it makes vehicles and drives while the first one trains.

What each of both makes is fixed, and so are the threads of each: which is faster changes no result.
"""

from __future__ import annotations

import io
import logging
import multiprocessing
from multiprocessing.connection import Connection
from pathlib import Path

from rich.console import Console

from recast.core import Artefact, diagnostics, open_store
from recast.core.diagnostics import Diagnostics
from recast.core.plugins import GENERATORS, PLANNERS, SEGMENTERS
from recast.core.workers import (
    Closing,
    begin_worker,
    one_thread_in_children,
    usable_cores,
    use_threads,
)
from recast.runs.arms import Arm, truth_of
from recast.runs.artefacts import Artefacts
from recast.runs.config import RunConfig
from recast.runs.sources import SourceLog, Sources

_LOG = logging.getLogger(__name__)


class Ahead(Closing):
    """Makes some artefacts of a run in a second process, on one thread; close it.

    Users' code runs in the first process alone, and so does everything where there is one core or
    one thread. What the second process could not make, the first one makes: its errors are told
    there.

    Args:
        artefacts: those of the run.
        store: place of their store.
        needed: False for a run that was finished before, whose artefacts are all there.
    """

    def __init__(self, artefacts: Artefacts, store: str, needed: bool = True) -> None:
        self._artefacts, self._store, self._needed = artefacts, store, needed
        threads = artefacts.config.threads or usable_cores()
        self._threads = threads - 1 if threads > 1 and usable_cores() > 1 else 0
        self._begun: list[tuple[str, ...]] = []
        self._ended = 0
        self._process: multiprocessing.process.BaseProcess | None = None
        self._pipe: Connection | None = None

    def vehicles(self, arm: Arm) -> None:
        """Begin the vehicles of an arm, as far as its street is not needed."""
        if GENERATORS.is_own(str(arm.generator)) and SEGMENTERS.is_own(str(arm.segmenter)):
            for track in self._artefacts.tracks():
                self._begin("registered", arm.name, track)

    def rollouts(self, arm: Arm) -> None:
        """Begin the rollouts of an arm, whose street and vehicles are there."""
        config = self._artefacts.config
        if config.plan_limit_s is not None or config.restorer is not None:
            return  # a planner's time is its own, and so is another program's
        for planner in config.planners:
            if PLANNERS.is_own(planner):
                for motion in config.motions:
                    self._begin("rollout", motion, planner, arm.name)

    def truth(self, arm: Arm) -> None:
        """Begin to compare the vehicle of an arm, which is there, with the truth."""
        if truth_of(self._artefacts.config.arms) is not None:
            self._begin("truth", arm.name)

    def finish(self, kind: str) -> None:
        """Wait for what was begun of a kind: "registered", "rollout" or "truth"."""
        while self._pipe is not None and kind in (job[0] for job in self._begun[self._ended :]):
            with self._artefacts.console.status("waiting for the second process"):
                try:
                    made: tuple[str, str] | None = self._pipe.recv()
                except (EOFError, OSError):  # it was killed: all that is left is made here
                    self.close()
                    return
            self._ended += 1
            if made is not None:
                reference, told = made
                self._artefacts.maker.elsewhere[reference] = told

    def close(self) -> None:
        """End the second process, at once if it is at work; that work is lost."""
        if self._process is not None and self._pipe is not None:
            self._pipe.close()
            if self._ended < len(self._begun):
                self._process.kill()
            self._process.join()
            self._process = self._pipe = None
            use_threads(self._artefacts.config.threads)

    def _begin(self, *job: str) -> None:
        if self._threads == 0:
            return
        if self._pipe is None:
            if self._begun:  # it was killed
                return
            use_threads(self._threads)
            if not self._needed:
                return
            self._start()
        assert self._pipe is not None
        self._begun.append(job)
        self._pipe.send(job)

    def _start(self) -> None:
        artefacts = self._artefacts
        context = multiprocessing.get_context("spawn")  # see `in_processes`
        self._pipe, theirs = context.Pipe()
        config = artefacts.config.model_dump(mode="json")
        width, records = artefacts.console.width, diagnostics.current()
        log = artefacts.source.path
        given = (theirs, self._store, log, config, artefacts.sources, width, records)
        process = context.Process(target=_serve, args=given)
        with one_thread_in_children():
            process.start()
        theirs.close()
        self._process = process


def _serve(
    pipe: Connection,
    store: str,
    log: Path,
    config: dict[str, object],
    sources: Sources,
    width: int,
    records: Diagnostics,
) -> None:
    begin_worker()
    diagnostics.begin(records)
    run = RunConfig.model_validate(config)
    source = SourceLog.open(log)
    console = Console(width=width, force_terminal=False)
    artefacts = Artefacts(
        open_store(store), source, run, sources, console, source.log.name, oracle_workers=1
    )
    while True:
        try:
            job = pipe.recv()
        except EOFError:
            return
        console.file = told = io.StringIO()
        try:
            made = _make(artefacts, job)
        except Exception:  # the first process will meet it, too
            _LOG.debug("%s: failed in the second process", job, exc_info=True)
            pipe.send(None)
        else:
            pipe.send((made.reference, told.getvalue()))


def _make(artefacts: Artefacts, job: tuple[str, ...]) -> Artefact:
    match job:
        case ("registered", arm, track):
            return artefacts.registered(artefacts.arms[arm], track)
        case ("rollout", motion, planner, arm):
            return artefacts.rollout(motion, planner, artefacts.arms[arm])
        case ("truth", arm):
            return artefacts.truth(artefacts.arms[arm])
    raise ValueError(job)
