"""Crews: outcomes bring new jobs, and any crew does the same; Ray by a stand-in."""

from __future__ import annotations

import logging
import os
import sys
from collections import deque
from collections.abc import Callable
from pathlib import Path
from types import ModuleType, SimpleNamespace

import pytest

from recast import diagnostics
from recast.crews import Crew, alone, crew_of, in_processes
from recast.diagnostics import Diagnostics
from recast.errors import InputError


def start(number: int, factor: int) -> Callable[[int], int]:
    if factor == 0:
        raise InputError("factor", "value", "is 0", "give another")
    return lambda job: job * factor


def done_by(crew: Crew, factor: int = 10) -> list[tuple[int, int]]:
    """Jobs 0 to 3; the outcome of job 2 brings jobs 100 and 101."""
    left, found = deque(range(4)), []
    for job, outcome in crew(
        start, (factor,), lambda: left.popleft() if left else None, "finished jobs"
    ):
        found.append((job, outcome))
        if job == 2:
            left.extend((100, 101))
    return sorted(found)


EXPECTED = [(0, 0), (1, 10), (2, 20), (3, 30), (100, 1000), (101, 1010)]


@pytest.fixture
def fake_ray(monkeypatch: pytest.MonkeyPatch) -> SimpleNamespace:
    """As much of Ray as the crew uses, in this process; notes what was asked of it."""
    seen = SimpleNamespace(resources=[], open=False)
    ray = ModuleType("ray")

    class RayTaskError(Exception):
        cause: Exception

    class Method:
        def __init__(self, method: Callable[[int], int]) -> None:
            self._method = method

        def remote(self, job: int) -> Callable[[], int]:
            return lambda: self._method(job)

    class Actor:
        def __init__(self, made: object) -> None:
            self.do = Method(made.do)  # type: ignore[attr-defined]

    def remote(**resources: int) -> Callable[[type], SimpleNamespace]:
        seen.resources.append(resources)
        return lambda kind: SimpleNamespace(remote=lambda *args: Actor(kind(*args)))

    def get(future: Callable[[], int]) -> int:
        try:
            return future()
        except InputError as error:
            wrapped = RayTaskError()
            wrapped.cause = error
            raise wrapped from None

    ray.is_initialized = lambda: seen.open  # type: ignore[attr-defined]
    ray.init = lambda **_: setattr(seen, "open", True)  # type: ignore[attr-defined]
    ray.shutdown = lambda: setattr(seen, "open", False)  # type: ignore[attr-defined]
    ray.cluster_resources = lambda: {"GPU": 2.0}  # type: ignore[attr-defined]
    ray.remote, ray.get = remote, get  # type: ignore[attr-defined]
    ray.wait = lambda futures, num_returns: (futures[-1:], futures[:-1])  # type: ignore[attr-defined]
    ray.exceptions = SimpleNamespace(  # type: ignore[attr-defined]
        RayTaskError=RayTaskError, RayActorError=type("RayActorError", (Exception,), {})
    )
    monkeypatch.setitem(sys.modules, "ray", ray)
    return seen


def test_outcomes_bring_new_jobs() -> None:
    assert done_by(alone) == EXPECTED


def test_ray_does_the_same(fake_ray: SimpleNamespace) -> None:
    assert done_by(crew_of(3, ray="local", gpu=True)) == EXPECTED
    assert fake_ray.resources == [{"num_cpus": 1, "num_gpus": 1}]
    assert not fake_ray.open


def test_a_fault_of_the_start_reaches_the_caller(fake_ray: SimpleNamespace) -> None:
    for crew in (alone, crew_of(2, ray="local")):
        with pytest.raises(InputError, match="factor"):
            done_by(crew, factor=0)
    assert not fake_ray.open


def test_no_worker_and_no_ray_are_refused(monkeypatch: pytest.MonkeyPatch) -> None:
    with pytest.raises(InputError, match="workers"):
        crew_of(0)
    monkeypatch.setitem(sys.modules, "ray", None)
    with pytest.raises(InputError, match="not installed"):
        crew_of(2, ray="auto")


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
        crew = in_processes(1)
        done = list(crew(telling, (), lambda: jobs.popleft() if jobs else None, "jobs"))
    finally:
        diagnostics.begin(Diagnostics())
    lines = file.read_text().splitlines()
    for job, process in done:
        assert any(f"WARNING {process} recast.tests: job {job}" in line for line in lines)
    assert os.getpid() not in dict(done).values()
