"""Worker pools: outcomes bring new jobs, and any pool does the same."""

from __future__ import annotations

import logging
import os
import sys
from collections import deque
from collections.abc import Callable
from pathlib import Path
from typing import Any

import pytest

from recast.core import diagnostics
from recast.core.diagnostics import Diagnostics
from recast.core.errors import InputError
from recast.core.workers import WorkerPool, in_processes, in_this_process, usable_cores, worker_pool


def start(number: int, factor: int) -> Callable[[int], int]:
    if factor == 0:
        raise InputError("factor", "value", "is 0", "give another")
    return lambda job: job * factor


def done_by(pool: WorkerPool, factor: int = 10) -> list[tuple[int, int]]:
    """Jobs 0 to 3; the outcome of job 2 brings jobs 100 and 101."""
    left, found = deque(range(4)), []
    for job, outcome in pool(
        start, (factor,), lambda: left.popleft() if left else None, "finished jobs"
    ):
        found.append((job, outcome))
        if job == 2:
            left.extend((100, 101))
    return sorted(found)


EXPECTED = [(0, 0), (1, 10), (2, 20), (3, 30), (100, 1000), (101, 1010)]


def test_outcomes_bring_new_jobs() -> None:
    assert done_by(in_this_process) == EXPECTED


@pytest.mark.whole
def test_ray_does_the_same(monkeypatch: pytest.MonkeyPatch) -> None:
    ray: Any = pytest.importorskip("ray")
    monkeypatch.setenv("PYTHONPATH", str(Path(__file__).parents[1]))  # workers import this module
    monkeypatch.setenv("RAY_AUTH_MODE", "disabled")  # no token file in the home folder
    workers = min(2, usable_cores())  # each waits for a core of its own
    ray.init(address="local", log_to_driver=False)
    try:
        assert done_by(worker_pool(workers, ray="local", gpu=True)) == EXPECTED
        with pytest.raises(InputError, match="factor"):
            done_by(worker_pool(workers, ray="local"), factor=0)
        assert ray.is_initialized()  # a connection that was there stays
    finally:
        ray.shutdown()


def test_a_fault_of_the_start_reaches_the_caller() -> None:
    with pytest.raises(InputError, match="factor"):
        done_by(in_this_process, factor=0)


def test_no_worker_and_no_ray_are_refused(monkeypatch: pytest.MonkeyPatch) -> None:
    with pytest.raises(InputError, match="workers"):
        worker_pool(0)
    monkeypatch.setitem(sys.modules, "ray", None)
    with pytest.raises(InputError, match="not installed"):
        worker_pool(2, ray="auto")


def loaded(number: int) -> Callable[[int], tuple[bool, str | None]]:
    return lambda job: ("torch" in sys.modules, os.environ.get("OMP_NUM_THREADS"))


def test_workers_get_one_thread_and_no_torch(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setenv("OMP_NUM_THREADS", "7")
    jobs = deque(range(2))
    done = list(in_processes(2)(loaded, (), lambda: jobs.popleft() if jobs else None, "jobs"))
    assert [outcome for _, outcome in done] == [(False, "1"), (False, "1")]
    assert os.environ["OMP_NUM_THREADS"] == "7"


def telling(number: int) -> Callable[[int], int]:
    def work(job: int) -> int:
        logging.getLogger("recast.tests").warning("job %s", job)
        return os.getpid()

    return work


def test_workers_write_to_the_same_records(tmp_path: Path) -> None:
    file = tmp_path / "file.log"
    diagnostics.begin(Diagnostics(file=file))
    try:
        jobs = deque(range(3))
        pool = in_processes(1)
        done = list(pool(telling, (), lambda: jobs.popleft() if jobs else None, "jobs"))
    finally:
        diagnostics.begin(Diagnostics())
    lines = file.read_text().splitlines()
    for job, process in done:
        assert any(f"WARNING {process} recast.tests: job {job}" in line for line in lines)
    assert os.getpid() not in dict(done).values()
