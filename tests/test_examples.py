"""The examples run as they stand, on any log."""

from __future__ import annotations

import importlib.util
import runpy
from pathlib import Path

import pytest

from recast.planning import make_planner

EXAMPLES = Path(__file__).resolve().parents[1] / "examples"


@pytest.mark.parametrize(
    ("name", "said"),
    [
        ("your_planner", "to "),
        ("navsim_agent", "plans by coasting"),
    ],
)
def test_an_example_runs(
    name: str,
    said: str,
    tiny_log_folder: Path,
    monkeypatch: pytest.MonkeyPatch,
    capsys: pytest.CaptureFixture[str],
) -> None:
    path = EXAMPLES / f"{name}.py"
    monkeypatch.setattr("sys.argv", [str(path), str(tiny_log_folder), "advancing-a"])
    runpy.run_path(str(path), run_name="__main__")
    out = capsys.readouterr().out
    assert said in out and int(out.split()[0]) >= 10


def test_plugging_in_a_planner_takes_less_than_thirty_lines() -> None:
    assert len((EXAMPLES / "your_planner.py").read_text().splitlines()) < 30


def test_the_agent_can_be_named(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.syspath_prepend(EXAMPLES.parent)
    assert importlib.util.find_spec("examples.navsim_agent") is not None
    planner = make_planner("navsim:examples.navsim_agent:Coasting")
    assert planner.name == "coasting" and planner.needs_images
