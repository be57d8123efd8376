"""The cells of a generation study in several processes, each with one thread."""

from __future__ import annotations

import multiprocessing
import signal
from collections import deque
from collections.abc import Callable, Sequence
from concurrent.futures import FIRST_COMPLETED, Future, ProcessPoolExecutor, wait

import torch

from recast.evaluation.generation_placement import Placement
from recast.pipeline.generation_maker import CellJob, CellMaker, Measures
from recast.synthetic.child_process import end_with_parent, one_thread, worker_faults

Told = Callable[[CellJob, dict[str, float]], None]
"""Called with every job that is done and the seconds it took."""

_WAITING = 2
"""Jobs handed out for each process: one at work, one waiting."""

_arguments: tuple[Measures, int, Placement]
_maker: CellMaker | None = None


def make_cells(
    jobs: Sequence[CellJob],
    measures: Measures,
    seed: int,
    placement: Placement,
    workers: int,
    told: Told,
) -> None:
    """Make and write all cells; the files are the same bytes for any number of workers.

    Args:
        jobs: those of one model in a row, since every process keeps just one loaded.
        measures, seed, placement: see `CellMaker`.
        workers: processes; with one, all is done in this process.
        told: of each job, in the order in which they end.

    Raises:
        InputError: see `CellMaker`, or a process was killed. Finished cells stay.
    """
    if workers == 1 or len(jobs) < 2:
        with one_thread():
            maker = CellMaker(measures, seed, placement)
            for job in jobs:
                told(job, maker(job))
        return
    # Spawned, not forked: the display of the parent draws from a thread, which may hold a lock.
    context = multiprocessing.get_context("spawn")
    processes = min(workers, len(jobs))
    with ProcessPoolExecutor(
        processes, context, _start, ((measures, seed, placement),)
    ) as pool:  # fmt: skip
        left = deque(jobs)
        pending: dict[Future[dict[str, float]], CellJob] = {}
        with worker_faults(pool, "finished vehicles"):
            while left or pending:
                while left and len(pending) < _WAITING * processes:
                    job = left.popleft()
                    pending[pool.submit(_make, job)] = job
                done, _ = wait(pending, return_when=FIRST_COMPLETED)
                for future in done:
                    told(pending.pop(future), future.result())


def _start(arguments: tuple[Measures, int, Placement]) -> None:
    global _arguments
    signal.signal(signal.SIGINT, signal.SIG_IGN)  # the parent ends its workers itself
    end_with_parent()
    torch.set_num_threads(1)
    _arguments = arguments


def _make(job: CellJob) -> dict[str, float]:
    global _maker
    if _maker is None:  # here, not in _start, so that its errors reach the parent
        _maker = CellMaker(*_arguments)
    return _maker(job)
