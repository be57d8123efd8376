"""The second process of a run: the same artefacts as without it, and as when it is killed."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace
from pathlib import Path

import pytest
from rich.console import Console

from recast.core import open_store
from recast.core.workers import usable_cores
from recast.planning import IdmLaneFollower
from recast.runs import ahead
from recast.runs.ahead import Ahead
from recast.runs.run import DemoSize, demo
from recast.simulation import MOTIONS

SIZE = DemoSize(2.0, 192, 128, ("front",), 20, (MOTIONS["cut-in-a"],), 10, "idm-follower")
OTHERWISE = ("actor/actor.json", "config.json", "scene.json")
"""Files that tell how long the work took, or on how many threads."""

pytestmark = [
    pytest.mark.whole,
    pytest.mark.skipif(usable_cores() < 2, reason="a second process needs a second core"),
]


def made(out: Path, threads: int, size: DemoSize = SIZE) -> dict[str, dict[str, str]]:
    """Runs the demo; the hashes of all files of its store that should be alike."""
    console = Console(quiet=True)
    demo(out, "urban-straight", 1, size, threads, console, generator="template")
    store = open_store(str(out / "store"))
    return {
        one.reference: {
            name: file.hash for name, file in one.record.files.items() if name not in OTHERWISE
        }
        for one in store.artefacts()
    }


@pytest.fixture(scope="module")
def alone(tmp_path_factory: pytest.TempPathFactory) -> dict[str, dict[str, str]]:
    return made(tmp_path_factory.mktemp("alone") / "out", 1)


@pytest.fixture
def begun(monkeypatch: pytest.MonkeyPatch) -> list[tuple[str, ...]]:
    """What is handed to the second process."""
    jobs: list[tuple[str, ...]] = []
    begin: Callable[..., None] = Ahead._begin

    def noted(self: Ahead, *job: str) -> None:
        jobs.append(job)
        begin(self, *job)

    monkeypatch.setattr(Ahead, "_begin", noted)
    return jobs


def test_two_processes_make_what_one_makes(
    alone: dict[str, dict[str, str]], begun: list[tuple[str, ...]], tmp_path: Path
) -> None:
    # With two threads, each process has one, as the single process of `alone` had.
    assert made(tmp_path / "out", 2) == alone
    assert begun == [
        ("registered", "replaced", "target"),
        ("rollout", "cut-in-a", "idm-follower", "oracle"),
        ("rollout", "cut-in-a", "idm-follower", "native"),
        ("rollout", "cut-in-a", "idm-follower", "replaced"),
        ("truth", "replaced"),
    ]


def test_a_second_process_that_is_killed_changes_nothing(
    alone: dict[str, dict[str, str]], monkeypatch: pytest.MonkeyPatch, tmp_path: Path
) -> None:
    monkeypatch.setattr(ahead, "_serve", _killed)
    assert made(tmp_path / "out", 2) == alone


def _killed(*given: object) -> None:
    """Ends at once, as if it had been killed."""


def test_users_code_runs_in_the_first_process_alone(
    begun: list[tuple[str, ...]], tmp_path: Path
) -> None:
    made(tmp_path / "out", 2, replace(SIZE, planner=f"{__name__}:Own"))
    assert {job[0] for job in begun} == {"registered", "truth"}


class Own(IdmLaneFollower):
    """A planner of a user."""
