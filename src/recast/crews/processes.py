"""Several processes of this machine, each with one thread."""

from __future__ import annotations

import multiprocessing
import signal
from collections.abc import Callable, Iterator
from concurrent.futures import FIRST_COMPLETED, Future, ProcessPoolExecutor, wait
from typing import Any

from recast import diagnostics
from recast.crews.child_process import end_with_parent, worker_faults
from recast.crews.crew import Crew, Job, Outcome, Start
from recast.diagnostics import Diagnostics

_WAITING = 2
"""Jobs handed out for each process: one at work, one waiting."""

_start: Callable[[], Callable[[Any], Any]]
_work: Callable[[Any], Any] | None = None


def in_processes(workers: int) -> Crew:
    """A crew of this many processes."""

    def crew(
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
        with ProcessPoolExecutor(workers, context, _set_up, initial) as pool:
            pending: dict[Future[Outcome], Job] = {}
            with worker_faults(pool, finished):
                while True:
                    while len(pending) < _WAITING * workers and (job := take()) is not None:
                        pending[pool.submit(_do, job)] = job
                    if not pending:
                        return
                    done, _ = wait(pending, return_when=FIRST_COMPLETED)
                    for future in done:
                        yield pending.pop(future), future.result()

    return crew


def _set_up(
    start: Start[Any, Any], arguments: tuple[Any, ...], numbers: Any, records: Diagnostics
) -> None:
    global _start
    import torch

    from recast.kernel import set_threads

    signal.signal(signal.SIGINT, signal.SIG_IGN)  # the parent ends its workers itself
    end_with_parent()
    diagnostics.begin(records)
    torch.set_num_threads(1)
    set_threads(1)
    number = numbers.get()
    _start = lambda: start(number, *arguments)  # noqa: E731


def _do(job: Any) -> Any:
    global _work
    if _work is None:  # not in _set_up, whose errors nobody would hear of
        _work = _start()
    return _work(job)
