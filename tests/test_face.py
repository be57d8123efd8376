"""The library's face: every name is there, costs nothing to import, and its doctest runs."""

from __future__ import annotations

import doctest
import importlib
import importlib.resources
import shutil
import subprocess
import sys
from collections.abc import Callable
from dataclasses import replace
from pathlib import Path
from typing import Any

import pytest

import recast
from recast.core.errors import InputError
from recast.splats import write_ply
from support.own_parts import Box

FUNCTIONS = (
    "evaluate",
    "load_log",
    "load_scene",
    "make_actor",
    "motion",
    "reconstruct",
    "run_grid",
    "score",
    "search",
    "Simulator",
    "write_report",
)


@pytest.fixture(scope="module")
def names(tiny_log_folder: Path, tmp_path_factory: pytest.TempPathFactory) -> dict[str, Any]:
    """What doctests may use: a log, its scene and actor, a planner and a rollout."""
    folder = tmp_path_factory.mktemp("face")
    shutil.copytree(tiny_log_folder, folder / "log")
    write_ply(folder / "car.ply", Box().generate(None, 0).gaussians)  # type: ignore[arg-type]
    log = recast.load_log(folder / "log")
    scene = recast.reconstruct(log, iterations=20, scale=0.5)
    planner = recast.make_planner("idm-follower")
    sim = recast.Simulator(
        log, scene, {"0": "advancing"}, settings=recast.RolloutSettings(steps=10), scale=0.5
    )
    planner.reset(sim.context)
    observation = sim.reset()
    while not sim.done:
        observation = sim.step(planner.plan(observation))
    return {
        "folder": folder,
        "log": log,
        "scene": scene,
        "planner": planner,
        "rollout": sim.rollout,
    }


@pytest.mark.parametrize("name", FUNCTIONS)
def test_the_example_of_a_name_runs(name: str, names: dict[str, Any]) -> None:
    module = sys.modules[getattr(recast, name).__module__]
    found = doctest.DocTestFinder(recurse=False).find(
        getattr(recast, name), name, module, extraglobs=names
    )
    assert len(found) == 1 and found[0].examples
    said: list[str] = []
    result = doctest.DocTestRunner().run(found[0], out=said.append)
    assert result.failed == 0, "".join(said)


def test_the_examples_outside_the_face_run(names: dict[str, Any]) -> None:
    source = Path(recast.__file__).parent
    face = {getattr(recast, name) for name in FUNCTIONS}
    ran = 0
    for path in source.rglob("*.py"):
        if ">>> " not in path.read_text():
            continue
        parts = path.relative_to(source.parent).with_suffix("").parts
        module = importlib.import_module(".".join(parts))
        for test in doctest.DocTestFinder().find(module, extraglobs=names):
            if not test.examples or getattr(module, test.name.split(".")[-1], None) in face:
                continue
            said: list[str] = []
            assert doctest.DocTestRunner().run(test, out=said.append).failed == 0, "".join(said)
            ran += 1
    assert ran


def test_what_is_shown_comes_from_the_objects(names: dict[str, Any]) -> None:
    pytest.importorskip("viser")
    page = recast.show(names["rollout"])
    try:
        inputs = page.playback.inputs
        assert inputs.log is names["rollout"].origin.setup.log
        assert set(inputs.scenes) == {"scene", names["rollout"].arm}
        assert any(name.startswith(names["rollout"].motion) for name in inputs.scenarios)
        assert page.url in page._repr_html_()
    finally:
        page.close()


def test_the_way_from_a_log_to_a_report(names: dict[str, Any], tmp_path: Path) -> None:
    """DESIGN's example: what was made before is found again."""
    log = recast.load_log(names["folder"] / "log")
    scene = recast.reconstruct(log, iterations=20, scale=0.5)
    store = names["folder"] / "store" / "scenes"
    assert [path.name for path in store.glob("[0-9a-f]*")] == [scene.origin.parent.name]
    actor = recast.make_actor(log, "0", generator=f"{names['folder']}/car.ply", axes="x,z")
    sim = recast.Simulator(
        log,
        scene.with_actor(actor),
        actors={"0": recast.motion("advancing")},
        settings=recast.RolloutSettings(steps=10),
        scale=0.5,
    )
    planner = recast.make_planner("constant-velocity")
    observation = sim.reset()
    while not sim.done:
        observation = sim.step(planner.plan(observation))
    told = str(recast.score(sim.rollout))
    assert "NC" in told and "R_c" in told and len(told.splitlines()) >= 7
    page = recast.write_report(sim.rollout, tmp_path / "report").read_text()
    assert "Advancing" in page and list((tmp_path / "report").rglob("*.mp4"))


def test_large_objects_are_shown_briefly(names: dict[str, Any]) -> None:
    log, rollout = names["log"], names["rollout"]
    actor = recast.make_actor(log, "0", generator=f"{names['folder']}/car.ply", axes="x,z")
    shown = {
        "DrivingLog": (log, "cameras=1, lidars=1, tracks=2, map=derived"),
        "StreetScene": (names["scene"], "actors=1"),
        "Actor": (actor, "track=0, category=car"),
        "Rollout": (rollout, "steps=10 of 10"),
        "RolloutMetrics": (recast.score(rollout), "NC=100.00 %"),
    }
    for name, (one, said) in shown.items():
        line, page = repr(one), one._repr_html_()
        assert line.startswith(f"{name}(") and line.endswith(")") and said in line, line
        assert len(line) < 200 and line.isprintable() and "array" not in line
        assert page.startswith(f"<table><caption>{name}</caption>") and len(page) < 2000
    hostile = replace(log, name="<b>\n" * 100)
    assert len(repr(hostile)) < 200 and "\n" not in repr(hostile)
    assert "<b>" not in hostile._repr_html_() and "&lt;b&gt;" in hostile._repr_html_()
    assert "DrivingLog object" in repr(replace(log, tracks=None))


def test_every_package_has_its_types() -> None:
    """The wheels hold whole packages, so the marker of PEP 561 is in them, too."""
    for package in ("recast", "recast_bridges", "recast_tools"):
        assert importlib.resources.files(package).joinpath("py.typed").is_file(), package


def test_what_takes_no_place_says_so(names: dict[str, Any]) -> None:
    with pytest.raises(InputError, match="track 9: is not in the log"):
        recast.make_actor(names["log"], "9")
    unknown = {**vars(names["rollout"]), "origin": None}
    with pytest.raises(InputError, match="map: is not stored"):
        recast.score(recast.Rollout(**unknown))
    with pytest.raises(AttributeError, match="nonesuch"):
        _ = recast.nonesuch


def test_importing_imports_nothing() -> None:
    code = "import sys, recast; print([m for m in ('numpy', 'torch', 'tyro') if m in sys.modules])"
    told = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=True)
    assert told.stdout.strip() == "[]"
    assert set(FUNCTIONS) <= set(dir(recast))


def test_a_log_that_lies_nowhere_has_no_store(names: dict[str, Any], tmp_path: Path) -> None:
    log = replace(names["log"])
    assert log.origin is None
    scene = recast.reconstruct(log, iterations=2, scale=0.5)
    assert scene.origin is None
    box = {"generator": "support.own_parts:Box", "store": tmp_path / "store"}
    assert recast.make_actor(log, "0", **box).track_id == "0"
    assert recast.make_actor(log, "0", **box).track_id == "0"
    assert [path.name for path in tmp_path.iterdir()] == ["store"]


WRONG: dict[str, tuple[Callable[[dict[str, Any]], object], str]] = {
    "log of None": (lambda n: recast.load_log(None), "load_log: source: is None; give"),
    "log of a number": (lambda n: recast.load_log(3), "load_log: source: is 3; give"),
    "log of a scene": (lambda n: recast.load_log(n["scene"].origin), "log.json: is missing"),
    "argument": (lambda n: recast.make_actor(n["log"], 0, genrator="x"), "did you mean generator"),
    "setting": (lambda n: recast.reconstruct(n["log"], iteratoins=3), "did you mean iterations"),
    "value": (lambda n: recast.reconstruct(n["log"], iterations="many"), "iterations"),
    "preset": (lambda n: recast.reconstruct(n["log"], preset="3dgs"), "one of streetgs, omnire"),
    "preset alike": (lambda n: recast.reconstruct(n["log"], preset="omnier"), "mean omnire?"),
    "config": (lambda n: recast.reconstruct(n["log"], config={}), "give a SceneConfig or None"),
    "no such path": (lambda n: recast.reconstruct("nowhere"), "nowhere: log folder: does not ex"),
    "folder of a log": (lambda n: recast.load_scene(n["folder"] / "log"), "scene.json"),
    "scene of None": (lambda n: recast.load_scene(None), "scene: NoneType: is NoneType"),
    "actor": (lambda n: recast.load_actor(n["folder"] / "log"), "actor.json"),
    "actor of None": (lambda n: recast.load_actor(None), "folder: is None; give a path"),
    "track": (lambda n: recast.make_actor(n["log"], 9), "track 9: is not in the log"),
    "track of None": (lambda n: recast.make_actor(n["log"], None), "track: is None; give a text"),
    "views": (lambda n: recast.make_actor(n["log"], "0", views="2"), "views: is '2'; give an int"),
    "generator": (lambda n: recast.make_actor(n["log"], "0", generator="tmplate"), "mean template"),
    "arguments": (lambda n: recast.evaluate(n["log"], n["scene"]), "scene: is an object of type"),
    "rollout": (lambda n: recast.score(n["log"]), "rollout: is an object of type DrivingLog; give"),
    "map": (lambda n: recast.score(n["rollout"], 3), "map: is 3; give a HdMap or a DrivingLog"),
    "report": (lambda n: recast.write_report(n["log"], "x"), "give a Rollout or its folder"),
    "grid": (lambda n: recast.run_grid(None, "x"), "scenes: is None; give a list of texts"),
    "grid's out": (lambda n: recast.run_grid("a", 7), "out: is 7; give a path"),
    "planner": (lambda n: recast.run_grid("urban-straight:3", "x", planners="idm-folower"), "idm-"),
    "planners": (lambda n: recast.run_grid("urban-straight:3", "x", planers="idm"), "n planners?"),
    "show nothing": (lambda n: recast.show(), "things: are missing"),
    "show logs": (lambda n: recast.show(n["log"], n["log"]), "are of several logs"),
    "show": (lambda n: recast.show(n["log"], 3), "cannot be shown beside objects: int"),
    "make_planner": (lambda n: recast.make_planner(None), "planner: is None; give"),
    "motion": (lambda n: recast.motion(3), "motion"),
    "actors": (lambda n: recast.Simulator(n["log"], actors=["0"]), "actors: is an object of type"),
    "steps": (
        lambda n: recast.Simulator(
            n["log"], actors={0: "cut-in"}, settings=recast.RolloutSettings(steps="9")
        ),
        "an integer",
    ),
    "sim's log": (lambda n: recast.Simulator(None), "Simulator: log: is None; give a DrivingLog"),
    "written": (lambda n: recast.write_log(None, "x"), "write_log: log: is None; give"),
}


@pytest.mark.parametrize("name", WRONG)
def test_wrong_arguments_are_refused_by_name(name: str, names: dict[str, Any]) -> None:
    call, line = WRONG[name]
    with pytest.raises(InputError) as refused:
        call(names)
    assert line in str(refused.value) and "\n" not in str(refused.value)


def test_paths_and_numbers_stand_for_what_they_name(names: dict[str, Any]) -> None:
    folder = names["folder"] / "log"
    scene = recast.reconstruct(str(folder), iterations=20, scale=0.5)  # type: ignore[arg-type]
    assert scene.origin == names["scene"].origin
    recast.Simulator(
        folder, scene.origin, {0: "advancing"}, settings=recast.RolloutSettings(steps=1)
    )  # type: ignore[arg-type,dict-item]
    car = names["folder"] / "car.ply"
    assert recast.make_actor(folder, 0, generator=car, axes="x,z").track_id == "0"  # type: ignore[arg-type]
    assert recast.score(names["rollout"], folder).values["nc"].value == 1.0  # type: ignore[arg-type]
