"""What every working process does at its start, and what is said when one ends too early."""

from __future__ import annotations

import multiprocessing
import os
import threading
from collections.abc import Iterator
from concurrent.futures import ProcessPoolExecutor
from concurrent.futures.process import BrokenProcessPool
from contextlib import contextmanager
from multiprocessing import connection

from recast.errors import InputError


def end_with_parent() -> None:
    """End this process as soon as its parent is gone.

    The workers of a killed run would else wait for jobs for ever, or write into the folders of the
    next run.
    """
    threading.Thread(target=_wait, daemon=True).start()


@contextmanager
def worker_faults(pool: ProcessPoolExecutor, finished: str) -> Iterator[None]:
    """While jobs of a pool are waited for: cancel what is left when anything goes wrong.

    Args:
        pool: of the jobs.
        finished: what stays of an earlier try, such as "finished vehicles".

    Raises:
        InputError: a process ended, mostly for want of memory.
    """
    try:
        yield
    except BrokenProcessPool:
        raise InputError(
            "--workers", "process", "ended, perhaps for want of memory",
            f"run again with fewer; {finished} stay",
        ) from None  # fmt: skip
    except BaseException:
        pool.shutdown(wait=False, cancel_futures=True)
        raise


@contextmanager
def one_thread() -> Iterator[None]:
    """Compute on one torch thread, as working processes do: others round sums otherwise."""
    import torch

    before = torch.get_num_threads()
    torch.set_num_threads(1)
    try:
        yield
    finally:
        torch.set_num_threads(before)


def _wait() -> None:
    parent = multiprocessing.parent_process()
    if parent is not None:
        connection.wait([parent.sentinel])
        os._exit(1)
