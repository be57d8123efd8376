"""Worker pools: this process, or several of this machine, each with one thread."""

from __future__ import annotations

import multiprocessing
import os
import signal
import sys
import threading
from collections.abc import Callable, Iterator
from concurrent.futures import FIRST_COMPLETED, Future, ProcessPoolExecutor, wait
from concurrent.futures.process import BrokenProcessPool
from contextlib import contextmanager
from multiprocessing import connection
from typing import Any, Protocol, Self, TypeVar

from recast.core import diagnostics
from recast.core.diagnostics import Diagnostics
from recast.core.errors import InputError
from recast.kernel import set_threads

Job = TypeVar("Job")
Outcome = TypeVar("Outcome")

Start = Callable[..., Callable[[Job], Outcome]]
"""Called once by each worker, with its number and the arguments: makes what does the jobs.

A function of a module, so that other processes find it.
"""
WAITING = 2
"""Jobs handed out for each process: one at work, one waiting."""
_THREAD_SETTINGS = ("OMP_NUM_THREADS", "OPENBLAS_NUM_THREADS", "MKL_NUM_THREADS")

_start: Callable[[], Callable[[Any], Any]]
_work: Callable[[Any], Any] | None = None


class WorkerPool(Protocol):
    """Does jobs; what comes of each may not depend on which worker did it or what it did before."""

    def __call__(
        self,
        start: Start[Job, Outcome],
        arguments: tuple[Any, ...],
        take: Callable[[], Job | None],
        finished: str,
    ) -> Iterator[tuple[Job, Outcome]]:
        """Jobs with their outcomes, in the order in which they end.

        Args:
            start: see `Start`.
            arguments: arguments of `start` after the worker's number, which counts from 0.
            take: gives the next job, or None where there is none now. It is asked again after each
                outcome, so that outcomes may bring new jobs; it ends when nothing is at work.
            finished: what stays of an earlier try, such as "finished vehicles".

        Raises:
            InputError: a worker was killed.
            Exception: whatever `start` or a job raises; no other job is begun then.
        """


def in_this_process(
    start: Start[Job, Outcome],
    arguments: tuple[Any, ...],
    take: Callable[[], Job | None],
    finished: str,
) -> Iterator[tuple[Job, Outcome]]:
    """Do all jobs in this process, on one thread as the workers do."""
    del finished
    with _one_thread():
        work: Callable[[Job], Outcome] | None = None
        while (job := take()) is not None:
            if work is None:
                work = start(0, *arguments)
            yield job, work(job)


def in_processes(workers: int) -> WorkerPool:
    """A pool of this many processes."""

    def pool(
        start: Start[Job, Outcome],
        arguments: tuple[Any, ...],
        take: Callable[[], Job | None],
        finished: str,
    ) -> Iterator[tuple[Job, Outcome]]:
        # Spawned, not forked: CUDA and the threads of this process do not survive a fork, and the
        # display of the parent draws from a thread, which may hold a lock.
        context = multiprocessing.get_context("spawn")
        numbers: Any = context.SimpleQueue()
        for number in range(workers):
            numbers.put(number)
        initial = (start, arguments, numbers, diagnostics.current())
        with ProcessPoolExecutor(workers, context, _set_up, initial) as executor:
            pending: dict[Future[Outcome], Job] = {}
            with _cancelling(executor, finished):
                while True:
                    while len(pending) < WAITING * workers and (job := take()) is not None:
                        pending[submit(executor, _do, job)] = job
                    if not pending:
                        return
                    done, _ = wait(pending, return_when=FIRST_COMPLETED)
                    for future in done:
                        yield pending.pop(future), future.result()

    return pool


def _set_up(
    start: Start[Any, Any], arguments: tuple[Any, ...], numbers: Any, records: Diagnostics
) -> None:
    global _start
    begin_worker()
    diagnostics.begin(records)
    number = numbers.get()
    _start = lambda: start(number, *arguments)  # noqa: E731


def _do(job: Any) -> Any:
    global _work
    if _work is None:  # not in _set_up, whose errors nobody would hear of
        _work = _start()
    return _work(job)


class Closing:
    """A context manager that ends with `close`."""

    def close(self) -> None:
        """Give back what is held."""

    def __enter__(self) -> Self:
        """Nothing starts before it is needed."""
        return self

    def __exit__(self, *fault: object) -> None:
        """Close, whatever happened."""
        self.close()


def submit(
    executor: ProcessPoolExecutor, function: Callable[..., Outcome], *arguments: Any
) -> Future[Outcome]:
    """Hand out a call; a process that is started for it will compute on one thread."""
    with _one_thread_in_children():
        return executor.submit(function, *arguments)


def begin_worker() -> None:
    """Make this process a worker: on one thread, and ended by its parent alone."""
    signal.signal(signal.SIGINT, signal.SIG_IGN)  # the parent ends its workers itself
    end_with_parent()
    use_threads(1)


def use_threads(count: int) -> None:
    """Compute on `count` threads in this process, 0 for one on each usable core.

    Of torch this changes nothing where it is imported later: it reads the environment.
    """
    count = count or usable_cores()
    if torch := sys.modules.get("torch"):
        torch.set_num_threads(count)
    set_threads(count)


def end_with_parent() -> None:
    """End this process as soon as its parent is gone.

    The workers of a killed run would else wait for jobs for ever, or write into the folders of the
    next run.
    """
    threading.Thread(target=_wait, daemon=True).start()


@contextmanager
def _cancelling(executor: ProcessPoolExecutor, finished: str) -> Iterator[None]:
    """While jobs of an executor are waited for: cancel what is left when anything goes wrong.

    Args:
        executor: executor of the jobs.
        finished: what stays of an earlier try, such as "finished vehicles".

    Raises:
        InputError: a process ended, mostly for want of memory.
    """
    try:
        yield
    except BrokenProcessPool:
        raise InputError(
            "`workers`",
            "process",
            "ended, perhaps out of memory",
            f"run again with fewer workers; {finished} are kept",
        ) from None
    except BaseException:
        executor.shutdown(wait=False, cancel_futures=True)
        raise


@contextmanager
def _one_thread() -> Iterator[None]:
    """Compute on one thread, as workers do: more threads round sums otherwise."""
    torch = sys.modules.get("torch")
    before = torch.get_num_threads() if torch else usable_cores()
    if torch:
        torch.set_num_threads(1)
    try:
        with _one_thread_in_children():  # read by torch too if it is imported meanwhile
            yield
    finally:
        if torch := sys.modules.get("torch"):
            torch.set_num_threads(before)


@contextmanager
def _one_thread_in_children() -> Iterator[None]:
    """Libraries that are loaded meanwhile, here or in a new process, compute on one thread."""
    before = {name: os.environ.get(name) for name in _THREAD_SETTINGS}
    os.environ.update(dict.fromkeys(_THREAD_SETTINGS, "1"))
    try:
        yield
    finally:
        for name, value in before.items():
            if value is None:
                del os.environ[name]
            else:
                os.environ[name] = value


def usable_cores() -> int:
    """Cores that this process may run on: fewer than the machine has if it was given a share."""
    if hasattr(os, "sched_getaffinity"):  # only on Linux
        return len(os.sched_getaffinity(0))
    return os.cpu_count() or 1


def _wait() -> None:
    parent = multiprocessing.parent_process()
    if parent is not None:
        connection.wait([parent.sentinel])
        os._exit(1)
