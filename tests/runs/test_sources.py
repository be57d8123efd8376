"""Nothing stale is called finished: a part that was edited is used anew, and nothing else is."""

from __future__ import annotations

import importlib
import json
import os
import shutil
import sys
from collections.abc import Callable
from pathlib import Path
from types import SimpleNamespace
from typing import Any

import pytest
from rich.console import Console

from recast.cli.main import main
from recast.core import Artefact, Store, files
from recast.logs import DrivingLog
from recast.reconstruction import SceneConfig
from recast.reconstruction.config import write_config
from recast.reconstruction.train import CONFIG_FILE
from recast.runs import making, sources
from recast.runs.sources import SourceLog
from support.moments import forked

PLANNER = """
from beside_planner import SHARE
from recast.planning import Plan
from recast.planning.simple import IdmLaneFollower

class Mine(IdmLaneFollower):
    name = "mine"
    def plan(self, observation):
        return Plan(super().plan(observation).waypoints * SHARE)
"""
GENERATOR = """
from support.own_parts import Box

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


def made_by(out: Path, command: list[str]) -> Run:
    """What a command makes each time it is run: uses of new artefacts, and its own files."""
    store = out.parent / "store"

    def folders() -> set[str]:
        return {path.parent.name for path in store.rglob("artefact.json")}

    def times() -> dict[str, int]:
        found = (*out.glob("metrics.json"), *out.glob("report/index.html"))
        return {path.relative_to(out).parts[0]: path.stat().st_mtime_ns for path in found}

    def run() -> set[str]:
        before, written = folders(), times()
        assert main(command) == 0
        new = folders() - before
        runs = [files.read_json(path)["artefacts"] for path in out.rglob("run.json")]
        uses = [(use, key.split("/")[1]) for artefacts in runs for use, key in artefacts.items()]
        assert new <= {key for _, key in uses}, "all that was made is used"
        return {use for use, key in uses if key in new} | {
            name for name, time in times().items() if written.get(name) != time
        }

    return run


def rollouts(planner: str, *motions: str) -> set[str]:
    return {
        f"rollout/{motion}/{planner}/{arm}"
        for motion in motions or ("advancing-a",)
        for arm in ("native", "replaced")
    }


MINE = rollouts("my_planner:Mine")
SCENE = {"scene/recast", "evaluation/recast"}
VEHICLE = {"registered/replaced", "actor/replaced", "turntable/replaced"}
OWN = {"metrics.json", "report"}


def options(log: Path, out: Path, *more: str, track: str = "0") -> list[str]:
    command = ["run", str(log), "--track", track, "--out", str(out), "--threads", "1"]
    command += ["--steps", "10", "--iterations", "4", "--scale", "1"]  # track 1 is seen well
    return [*command, "--generator", "my_generator:Mine", *more]


@pytest.mark.whole
def test_a_run_makes_again_what_was_edited_and_what_follows(
    code: Callable[[str, str], None],
    tiny_log_folder: Path,
    tmp_path: Path,
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    out, log = tmp_path / "run", tiny_log_folder
    asked = ("--motion", "advancing-a", "--planner", "my_planner:Mine")
    run = made_by(out, options(log, out, *asked))
    assert run() == SCENE | VEHICLE | MINE | OWN
    assert run() == set()
    first = json.loads((out / "metrics.json").read_text())["rollouts"]

    code("my_planner", PLANNER + "# a remark\n")
    assert run() == MINE | OWN
    assert json.loads((out / "metrics.json").read_text())["rollouts"] == first

    code("beside_planner", "SHARE = 0.5\n")  # a module that the planner's imports
    assert run() == MINE | OWN
    slower = json.loads((out / "metrics.json").read_text())["rollouts"]
    assert slower != first, "the new planner drove"

    code("beside_planner", "SHARE = 1.0\n")  # as before: what it made then is still there
    assert run() == OWN
    assert json.loads((out / "metrics.json").read_text())["rollouts"] == first

    code("my_generator", GENERATOR.replace("first", "second"))
    replaced = {use for use in MINE if use.endswith("/replaced")}
    assert run() == VEHICLE | replaced | OWN

    monkeypatch.setitem(sources.RECIPES, "metrics", sources.RECIPES["metrics"] + 1)
    assert run() == {"metrics.json"}
    assert run() == set()

    # Other runs beside it train nothing, whatever they ask of the same street.
    def other(name: str, *more: str, track: str = "0") -> set[str]:
        made = made_by(tmp_path / name, options(log, tmp_path / name, *more, track=track))()
        assert made >= OWN
        return made - OWN

    idm, follower = rollouts("idm-follower"), ("--planner", "idm-follower")
    assert other("planner", "--motion", "advancing-a", *follower) == idm
    assert other("both", *asked, "--planner", "idm-follower") == set()
    motions = rollouts("idm-follower", "advancing-b")
    assert (
        other("motion", "--motion", "advancing-a", "--motion", "advancing-b", *follower) == motions
    )
    assert other("track", "--motion", "advancing-a", *follower, track="1") == VEHICLE | idm
    scene = ("--scene", str((out / "scenes" / "recast").resolve()))
    taken = SCENE | VEHICLE - {"registered/replaced"} | idm
    assert other("scene", "--motion", "advancing-a", *follower, *scene) == taken
    trained = [one for one in Store(tmp_path / "store").artefacts() if one.record.kind == "scenes"]
    assert sum("config" in one.record.inputs for one in trained) == 1


@pytest.mark.whole
def test_a_run_and_its_store_go_on_elsewhere(
    code: Callable[[str, str], None], tiny_log_folder: Path, tmp_path: Path
) -> None:
    """Copied together, with or without their links; the report is written there, too."""
    first, log = tmp_path / "first" / "run", tiny_log_folder
    asked = ("--motion", "advancing-a", "--arm", "native")
    assert main(options(log, first, *asked)) == 0
    page = (first / "report" / "index.html").read_bytes()
    for number, symlinks in enumerate((True, False)):
        folder = tmp_path / str(number)
        shutil.copytree(first.parent, folder, symlinks=symlinks)
        out = folder / "run"
        shutil.rmtree(out / "report")
        assert main(["report", str(out)]) == 0
        assert (out / "report" / "index.html").read_bytes() == page
        assert made_by(out, options(log, out, *asked))() == set()
    shutil.rmtree(first.parent)
    code("my_planner", PLANNER)
    out = tmp_path / "0" / "other"
    run = made_by(out, options(log, out, *asked, "--planner", "my_planner:Mine"))
    assert run() == {"rollout/advancing-a/my_planner:Mine/native"} | OWN
    shutil.rmtree(tmp_path / "1" / "store")
    assert main(["report", str(tmp_path / "1" / "run")]) == 2


@pytest.mark.whole
def test_two_runs_at_once_make_nothing_twice(tiny_log_folder: Path, tmp_path: Path) -> None:
    """One store, one process each: the slower waits for what the other is making."""
    log, store = tiny_log_folder, tmp_path / "store"
    numbers = []
    for name in ("one", "two"):
        command = options(log, tmp_path / name, "--motion", "advancing-a", "--store", str(store))
        command += ["--generator", "support.own_parts:Box", "--planner", "idm-follower"]
        notes = tmp_path / f"{name}.notes"

        def work(command: list[str] = command, notes: Path = notes) -> None:
            made, make = [], Store._made

            def noted(self: Store, kind: str, key: str, *more: Any) -> Artefact:
                made.append(f"{kind}/{key}")
                return make(self, kind, key, *more)

            Store._made = noted  # type: ignore[method-assign]
            assert main(command) == 0
            notes.write_text("\n".join(made))

        numbers.append(forked(work))
    assert [os.waitpid(number, 0)[1] for number in numbers] == [0, 0]
    made = [line for name in ("one", "two") for line in (tmp_path / f"{name}.notes").open()]
    references = [line.strip() for line in made]
    assert sorted(references) == sorted({one.reference for one in Store(store).artefacts()})
    assert len(references) == 7
    first, second = (files.read_json(tmp_path / n / "run.json") for n in ("one", "two"))
    assert first["artefacts"] == second["artefacts"]
    for name in ("metrics.json", "report/index.html"):
        assert (tmp_path / "one" / name).read_bytes() == (tmp_path / "two" / name).read_bytes()


def test_a_grid_makes_the_rollouts_of_an_edited_planner_again(
    code: Callable[[str, str], None], tiny_log_folder: Path, tmp_path: Path
) -> None:
    out = tmp_path / "grid"
    command = ["bench", "closed-loop", "--scenes", f"{tiny_log_folder}:0", "--out", str(out)]
    command += ["--motions", "advancing-a", "--steps", "10", "--samples", "100"]
    run = made_by(out, [*command, "--planner", "my_planner:Mine"])
    assert run() == MINE
    assert run() == set()
    first = (out / "results.json").read_bytes()
    code("beside_planner", "SHARE = 0.5\n")
    assert run() == MINE
    assert (out / "results.json").read_bytes() != first
    code("beside_planner", "SHARE = 1.0\n")
    assert run() == set(), "these are still there"
    assert (out / "results.json").read_bytes() == first


def test_a_planner_that_is_edited_while_a_grid_runs_counts_as_the_older_one(
    code: Callable[[str, str], None], tiny_log_folder: Path, tmp_path: Path
) -> None:
    """The process goes on with the code that it loaded; the next grid uses the new one."""
    edited = PLANNER + "# a remark\n"
    file = tmp_path / "code" / "my_planner.py"
    edits = (
        f"    def plan(self, observation):\n        open({str(file)!r}, 'w').write({edited!r})\n"
    )
    code("my_planner", PLANNER.replace("    def plan(self, observation):\n", edits))
    out = tmp_path / "grid"
    scenes = [f"{tiny_log_folder}:{track}" for track in ("0", "1")]
    command = ["bench", "closed-loop", "--scenes", *scenes, "--out", str(out)]
    command += ["--motions", "advancing-a", "--steps", "10", "--samples", "100"]
    run = made_by(out, [*command, "--planner", "my_planner:Mine"])
    assert run() == MINE
    assert file.read_text() == edited
    code("my_planner", edited)
    before = len(list((tmp_path / "store" / "rollouts").glob("[!.]*")))
    assert run() == MINE
    assert len(list((tmp_path / "store" / "rollouts").glob("[!.]*"))) == 2 * before == 8


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


def test_a_street_is_trained_again_where_a_file_of_bodies_was_edited(
    tiny_log_folder: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    def train(log: DrivingLog, out: Path, config: SceneConfig, progress: object) -> SimpleNamespace:
        out.mkdir(exist_ok=True)
        return SimpleNamespace(budget=SimpleNamespace(explain=str))

    monkeypatch.setattr(making, "train_scene", train)
    maker = making.Maker(Store(tmp_path / "store"), Console(quiet=True))
    source = SourceLog.open(tiny_log_folder)
    files = {name: str(tmp_path / f"{name}.npz") for name in ("smpl_model", "smpl_poses")}
    config = SceneConfig(**files)
    found = []
    for content in (b"one", b"one", b"other"):
        for path in files.values():
            Path(path).write_bytes(content)
        found.append(making.train_street(maker, source, config, "street").reference)
    assert found[0] == found[1] != found[2]


def test_a_refinement_is_made_again_where_a_file_of_bodies_was_edited(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    report = SimpleNamespace(kept=True, explain=str)
    refined = SimpleNamespace(provenance=SimpleNamespace(refinement=report))
    monkeypatch.setattr(making, "refine_actor", lambda *_: refined)
    monkeypatch.setattr(making, "load_scene", lambda path: path)
    maker = making.Maker(Store(tmp_path / "store"), Console(quiet=True))
    files = {name: str(tmp_path / f"{name}.npz") for name in ("smpl_model", "smpl_poses")}
    for name, config in (("street", SceneConfig(**files)), ("plain", SceneConfig())):
        (tmp_path / name).mkdir()
        write_config(config, tmp_path / name / CONFIG_FILE)

    def made(name: str) -> str:
        record = SimpleNamespace(name=name)
        part = SimpleNamespace(path=tmp_path / name, reference=name, record=record)
        return making.refine_vehicle(maker, part, part, 0).reference

    found, plain = [], []
    for content in (None, b"one", b"other"):
        for path in files.values():
            if content is not None:
                Path(path).write_bytes(content)
        found.append(made("street"))
        plain.append(made("plain"))
    assert len(set(found)) == 3 and len(set(plain)) == 1
