"""Nothing stale is called finished: a part that was edited is used anew, and nothing else is."""

from __future__ import annotations

import importlib
import json
import sys
from collections.abc import Callable
from pathlib import Path

import pytest

from recast.cli.main import main
from recast.pipeline import sources

PLANNER = """
from beside_planner import SHARE
from recast.planning import Plan
from recast.planning.idm_follower import IdmLaneFollower

class Mine(IdmLaneFollower):
    name = "mine"
    def plan(self, observation):
        return Plan(super().plan(observation).waypoints * SHARE)
"""
GENERATOR = """
from faults.parts import Box

class Mine(Box):
    name = "first"
"""

Run = Callable[[], set[str]]


@pytest.fixture
def code(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Callable[[str, str], None]:
    """Writes a user's module, as an editor does between two commands."""
    folder = tmp_path / "code"
    folder.mkdir()
    monkeypatch.syspath_prepend(folder)
    monkeypatch.setattr(sys, "dont_write_bytecode", True)

    def write(name: str, text: str) -> None:
        (folder / f"{name}.py").write_text(text)
        importlib.invalidate_caches()
        for module in ("my_planner", "beside_planner", "my_generator"):
            sys.modules.pop(module, None)

    write("beside_planner", "SHARE = 1.0\n")
    write("my_planner", PLANNER)
    write("my_generator", GENERATOR)
    return write


def steps_made(out: Path, command: list[str]) -> Run:
    """The steps that a command makes, by their markers, each time it is run."""

    def run() -> set[str]:
        before = {path: path.stat().st_mtime_ns for path in out.rglob("steps/*.json")}
        assert main(command) == 0
        after = {path: path.stat().st_mtime_ns for path in out.rglob("steps/*.json")}
        return {path.stem for path, time in after.items() if before.get(path) != time}

    return run


ROLLOUTS = {"rollout-advancing-a-native", "rollout-advancing-a-replaced"}


def test_a_run_makes_again_what_was_edited_and_what_follows(
    code: Callable[[str, str], None],
    tiny_log_folder: Path,
    tmp_path: Path,
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    monkeypatch.setattr("recast.pipeline.actor._TURNTABLE_VIEWS", 2)
    out = tmp_path / "run"
    command = ["run", str(tiny_log_folder), "--track", "0", "--out", str(out), "--threads", "1"]
    command += ["--motion", "advancing-a", "--steps", "10", "--iterations", "4", "--scale", "0.5"]
    command += ["--planner", "my_planner:Mine", "--generator", "my_generator:Mine"]
    run = steps_made(out, command)
    assert run() == {"actor", "scene", "refine", "evaluation", "metrics", "report"} | ROLLOUTS
    assert run() == set()
    first = json.loads((out / "metrics.json").read_text())["rollouts"]

    code("my_planner", PLANNER + "# a remark\n")
    assert run() == ROLLOUTS | {"metrics", "report"}
    assert json.loads((out / "metrics.json").read_text())["rollouts"] == first

    code("beside_planner", "SHARE = 0.5\n")  # a module that the planner's imports
    assert run() == ROLLOUTS | {"metrics", "report"}
    slower = json.loads((out / "metrics.json").read_text())["rollouts"]
    assert slower != first, "the new planner drove"

    code("my_generator", GENERATOR.replace("first", "second"))
    assert run() == {"actor", "refine", "rollout-advancing-a-replaced", "metrics", "report"}

    monkeypatch.setitem(sources.RECIPES, "metrics", sources.RECIPES["metrics"] + 1)
    assert run() == {"metrics", "report"}
    assert run() == set()


def test_a_grid_makes_the_rollouts_of_an_edited_planner_again(
    code: Callable[[str, str], None], tiny_log_folder: Path, tmp_path: Path
) -> None:
    out = tmp_path / "grid"
    command = ["bench", "closed-loop", "--scenes", f"{tiny_log_folder}:0", "--out", str(out)]
    command += ["--motions", "advancing-a", "--steps", "10", "--samples", "100"]
    run = steps_made(out, [*command, "--planner", "my_planner:Mine"])
    assert run() == ROLLOUTS | {"metrics"}
    assert run() == set()
    first = (out / "results.json").read_bytes()
    code("beside_planner", "SHARE = 0.5\n")
    assert run() == ROLLOUTS | {"metrics"}
    assert (out / "results.json").read_bytes() != first
    code("beside_planner", "SHARE = 1.0\n")
    assert run() == ROLLOUTS | {"metrics"}
    assert (out / "results.json").read_bytes() == first


def test_names_of_built_in_parts_stand_for_themselves() -> None:
    assert sources.planner_source("idm-follower") == "idm-follower"
    assert sources.generator_source("template") == "template"
    assert sources.segmenter_source("box-lidar") == "box-lidar"


def test_the_same_code_elsewhere_is_the_same_code(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    found = []
    for place in ("one", "two"):
        package = tmp_path / place / "mine_here"
        package.mkdir(parents=True)
        (package / "__init__.py").write_text("")
        (package / "planner.py").write_text(PLANNER)
        with monkeypatch.context() as patched:
            patched.syspath_prepend(tmp_path / place)
            found.append(sources.planner_source("mine_here.planner:Mine"))
            (package / "settings.py").write_text("x = 1")  # another file of the package
            found.append(sources.planner_source("mine_here.planner:Mine"))
            found.append(sources.planner_source("navsim:mine_here.planner:Mine"))
    assert found[:3] == found[3:]
    assert len(set(found[:3])) == 3
