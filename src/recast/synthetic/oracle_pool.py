"""Oracles of one world in several processes, each with one thread."""

from __future__ import annotations

import multiprocessing
import os
import pickle
import signal
from collections import deque
from collections.abc import Callable, Iterable, Iterator
from concurrent.futures import Future, ProcessPoolExecutor
from concurrent.futures.process import BrokenProcessPool
from contextlib import contextmanager
from itertools import islice
from pathlib import Path
from tempfile import TemporaryDirectory
from types import TracebackType
from typing import Self, TypeVar

from recast.cores import usable_cores
from recast.crews.child_process import end_with_parent
from recast.errors import InputError
from recast.synthetic.oracle import Oracle
from recast.synthetic.rendering import require_embree
from recast.synthetic.world import World

Job = TypeVar("Job")
Result = TypeVar("Result")

_THREAD_SETTINGS = ("OMP_NUM_THREADS", "OPENBLAS_NUM_THREADS", "MKL_NUM_THREADS")
_WAITING = 2
"""Jobs handed out for each process: one at work, one waiting."""

_oracle: Oracle | None = None


class OraclePool:
    """Calls functions with an oracle, several at a time; what they return does not depend on that.

    Use it as a context manager, or close it.

    Args:
        world: what the oracles show.
        workers: processes; 0 for one for each core, 1 for none but this one.
        most: jobs that there ever are at a time; more processes are never started.

    Raises:
        InputError: workers is negative, or embreex is not installed.
    """

    def __init__(self, world: World, workers: int = 0, most: int | None = None) -> None:
        require_embree()
        if workers < 0:
            raise InputError("workers", str(workers), "is negative", "choose 0 for all cores")
        wanted = workers or usable_cores()
        self.workers = wanted if most is None else max(1, min(wanted, most))
        self._world = world
        self._own: Oracle | None = None
        self._executor: ProcessPoolExecutor | None = None
        self._spool: TemporaryDirectory[str] | None = None

    def map(
        self, function: Callable[[Oracle, Job], Result], jobs: Iterable[Job]
    ) -> Iterator[Result]:
        """`function(oracle, job)` of every job, in their order.

        Args:
            function: of a module, so that other processes find it.

        Raises:
            InputError: a process was killed.
            Exception: whatever `function` raises.
        """
        if self.workers == 1:
            for job in jobs:
                yield function(self.oracle, job)
            return
        left = iter(jobs)
        waiting: deque[Future[Result]] = deque()
        try:
            executor = self._started()
            for job in islice(left, _WAITING * self.workers):
                waiting.append(executor.submit(_call, function, job))
            while waiting:
                result = waiting.popleft().result()
                for job in islice(left, 1):
                    waiting.append(executor.submit(_call, function, job))
                yield result
        except BrokenProcessPool:
            raise InputError(
                "workers",
                str(self.workers),
                "a rendering process was killed, or ended at its start",
                "use fewer workers if memory is short; guard a script's start by __name__",
            ) from None
        finally:
            for future in waiting:
                future.cancel()

    @property
    def oracle(self) -> Oracle:
        """An oracle in this process."""
        if self._own is None:
            self._own = Oracle(self._world)
        return self._own

    def close(self) -> None:
        """End the processes."""
        if self._executor is not None:
            self._executor.shutdown(wait=True, cancel_futures=True)
            self._executor = None
        if self._spool is not None:
            self._spool.cleanup()
            self._spool = None

    def __enter__(self) -> Self:
        """Nothing starts before it is needed."""
        return self

    def __exit__(
        self,
        kind: type[BaseException] | None,
        error: BaseException | None,
        trace: TracebackType | None,
    ) -> None:
        """End the processes."""
        self.close()

    def _started(self) -> ProcessPoolExecutor:
        if self._executor is None:
            # Not by initargs: their bytes go through a pipe that blocks for ever where a process
            # dies at its start, as it does in a script whose start is not guarded.
            self._spool = TemporaryDirectory(prefix="recast-world-")
            path = Path(self._spool.name) / "world"
            path.write_bytes(pickle.dumps(self._world))
            self._executor = ProcessPoolExecutor(
                self.workers,
                mp_context=multiprocessing.get_context("spawn"),
                initializer=_start,
                initargs=(path,),
            )
            with _one_thread():
                # All processes are started by the first job.
                self._executor.submit(_call, _nothing, None).result()
        return self._executor


@contextmanager
def _one_thread() -> Iterator[None]:
    """Processes started meanwhile compute with one thread: more would only get in the way."""
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


def _start(path: Path) -> None:
    global _oracle
    signal.signal(signal.SIGINT, signal.SIG_IGN)  # the parent ends its workers itself
    end_with_parent()
    _oracle = Oracle(pickle.loads(path.read_bytes()))  # written by the parent just now


def _call(function: Callable[[Oracle, Job], Result], job: Job) -> Result:
    assert _oracle is not None  # set by _start
    return function(_oracle, job)


def _nothing(oracle: Oracle, job: None) -> None:
    del oracle, job
