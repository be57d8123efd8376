"""Who makes the targets: this process, several, or a Ray cluster; the bytes are the same."""

from __future__ import annotations

import multiprocessing
import signal
from collections.abc import Callable, Iterable, Iterator
from concurrent.futures import FIRST_COMPLETED, Future, ProcessPoolExecutor, wait
from itertools import islice
from typing import Any

import torch

from recast.recar.targets.maker import Job, Outcome, TargetMaker
from recast.recar.targets.model_source import ModelSource
from recast.recar.targets.settings import TargetSettings
from recast.splats import set_threads
from recast.synthetic.child_process import end_with_parent, one_thread, worker_faults

Crew = Callable[[ModelSource, TargetSettings, Iterable[Job]], Iterator[Outcome]]
"""Outcomes of jobs, in any order."""

_WAITING = 2
"""Jobs handed out for each process: one at work, one waiting; each holds four pictures."""


def alone(source: ModelSource, settings: TargetSettings, jobs: Iterable[Job]) -> Iterator[Outcome]:
    """Make all targets in this process."""
    with one_thread():
        maker = TargetMaker.load(source, settings)
        for job in jobs:
            yield maker.make(job)


def in_processes(workers: int) -> Crew:
    """Make targets in several processes of this machine, each with a model and one thread."""

    def crew(
        source: ModelSource, settings: TargetSettings, jobs: Iterable[Job]
    ) -> Iterator[Outcome]:
        # Spawned, not forked: CUDA and the threads of this process do not survive a fork.
        context = multiprocessing.get_context("spawn")
        devices: Any = context.SimpleQueue()
        for device in _devices(source, workers):
            devices.put(device)
        left = iter(jobs)
        initial = (source, settings, devices)
        with ProcessPoolExecutor(workers, context, _set_up, initial) as pool:
            pending: set[Future[Outcome]] = set()
            with worker_faults(pool, "finished targets"):
                for job in islice(left, _WAITING * workers):
                    pending.add(pool.submit(_make, job))
                while pending:
                    done, pending = wait(pending, return_when=FIRST_COMPLETED)
                    for job in islice(left, len(done)):
                        pending.add(pool.submit(_make, job))
                    for future in done:
                        yield future.result()

    return crew


def _devices(source: ModelSource, workers: int) -> list[str | None]:
    if source.device is not None or not torch.cuda.is_available():
        return [source.device] * workers
    count = torch.cuda.device_count()
    return [f"cuda:{index % count}" for index in range(workers)]


_plan: tuple[ModelSource, TargetSettings, str | None]
_maker: TargetMaker | None = None


def _set_up(source: ModelSource, settings: TargetSettings, devices: Any) -> None:
    global _plan
    signal.signal(signal.SIGINT, signal.SIG_IGN)  # the parent ends its workers itself
    end_with_parent()
    torch.set_num_threads(1)
    set_threads(1)
    _plan = (source, settings, devices.get())


def _make(job: Job) -> Outcome:
    global _maker
    if _maker is None:  # not in _set_up, whose errors nobody would hear of
        _maker = TargetMaker.load(*_plan)
    return _maker.make(job)
