"""The examples run as they stand, on any log."""

from __future__ import annotations

import importlib.util
import re
import runpy
import shutil
from pathlib import Path

import pytest

from recast.cli.main import main
from recast.planning import make_planner
from recast.planning.types import ReferenceRoute
from recast.simulation import MOTIONS, RolloutSetup, run_rollout
from support.synthetic_drives import drive

EXAMPLES = Path(__file__).resolve().parents[1] / "examples"
PAGE = EXAMPLES.parent / "docs" / "examples.md"
NUMBERED = sorted(path.name for path in EXAMPLES.glob("[0-9]*.py"))
STEPS = "20"
"""Training steps: a scene of which only the shape is right."""


@pytest.fixture(scope="module")
def folder(tiny_log_folder: Path, tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A folder with the tiny log in it; the store comes to lie beside the log."""
    found = tmp_path_factory.mktemp("examples")
    shutil.copytree(tiny_log_folder, found / "log")
    return found


@pytest.fixture
def said(monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]):
    """Runs an example with arguments; returns what it printed."""

    def run(name: str, *arguments: object) -> str:
        monkeypatch.setattr("sys.argv", [name, *map(str, arguments)])
        runpy.run_path(str(EXAMPLES / name), run_name="__main__")
        return capsys.readouterr().out

    return run


@pytest.mark.whole
def test_1_shows_the_tracks(said, folder: Path) -> None:
    out = said("1_log.py", folder / "log")
    assert "track 0: car" in out and "track 1: van" in out and "(48, 160, 3)" in out


@pytest.mark.whole
def test_2_draws_the_street(said, folder: Path) -> None:
    out = said("2_scene.py", folder / "log", folder / "image.png", STEPS)
    assert "actors: 0" in out and (folder / "image.png").is_file()


@pytest.mark.whole
def test_3_makes_a_vehicle(said, folder: Path) -> None:
    out = said("3_actor.py", folder / "log", "0", folder / "actor", "template", STEPS, "no")
    assert "LiDAR to actor" in out and "refined by" not in out and "track 0 has" in out
    assert (folder / "actor" / "actor.json").is_file()


@pytest.mark.whole
@pytest.mark.slow  # a minute of refinement
def test_3_refines_the_vehicle(said, folder: Path) -> None:
    out = said("3_actor.py", folder / "log", "0", folder / "refined", "template", STEPS)
    assert "refined by" in out and "track 0 has" in out


@pytest.mark.whole
def test_4_drives_with_a_planner_of_its_own(said, folder: Path) -> None:
    out = said("4_rollout.py", folder / "log", "0", "advancing-a", folder / "report", STEPS)
    assert re.search(r"^ttc +[0-9.]+$", out, re.MULTILINE)
    page = folder / "report" / "index.html"
    assert out.splitlines()[-1] == str(page) and "careful" in page.read_text()


@pytest.mark.whole
def test_5_compares_arms_and_planners(said, folder: Path) -> None:
    out = said("5_grid.py", folder / "grid", f"{folder / 'log'}:0", "advancing-a")
    for planner in ("idm-follower", "constant-velocity"):
        assert f"{planner} replaced advancing-a: TTC" in out
        assert f"{planner}: replaced - native: +0.00 s TTC" in out  # neither looks at images
    assert (folder / "grid" / "rollouts.parquet").is_file()


@pytest.mark.whole
def test_6_steps_four_environments(said, folder: Path) -> None:
    out = said("6_gymnasium.py", folder / "log", "0", "advancing-a", "4")
    assert {line.split(":")[0] for line in out.splitlines()} == {
        f"environment {k}" for k in range(4)
    }


@pytest.mark.whole
def test_7_finds_where_a_planner_begins_to_fail(said, folder: Path) -> None:
    out = said("7_search.py", folder / "search", f"{folder / 'log'}:0", "advancing-a", "gap=1:4")
    assert "gtrs-mini: never fails" in out


def test_the_page_shows_them_as_they_are() -> None:
    page = PAGE.read_text()
    for name in NUMBERED:
        assert f'--8<-- "examples/{name}"' in page, name


@pytest.mark.whole
@pytest.mark.parametrize(
    ("name", "word"),
    [
        ("your_planner.py", "to "),
        ("navsim_agent.py", "plans by coasting"),
    ],
)
def test_a_planner_drives_without_a_scene(name: str, word: str, said, folder: Path) -> None:
    out = said(name, folder / "log", "advancing-a")
    assert word in out and int(out.split()[0]) >= 10


def test_an_ego_that_moves_over(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.syspath_prepend(EXAMPLES.parent)
    log = drive(speed=8.0, seconds=20.0)
    setup = RolloutSetup(log, "7", MOTIONS["advancing-b"], steps=80)
    rollout = run_rollout(setup, make_planner("examples.changes_lanes:ChangesLanes"))
    route = ReferenceRoute.from_trajectory(log.world_from_rig)
    _, lateral = route.project(rollout.ego[:, :2])
    assert abs(lateral[0]) < 0.1 and lateral[-1] == pytest.approx(3.0, abs=0.2)


def test_an_importer_of_ones_own(said, tmp_path: Path) -> None:
    out = said("your_importer.py", tmp_path / "drives", tmp_path / "log")
    assert out.splitlines() == [
        "DrivingLog(name=morning, seconds=4.0, cameras=1, lidars=0, tracks=1, map=no)",
        "track 7: car, 41 boxes",
    ]


def test_the_importer_is_named_on_the_command_line(
    said, tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    said("your_importer.py", tmp_path, tmp_path / "log")
    monkeypatch.syspath_prepend(EXAMPLES.parent)
    words = ["log", "import", "examples.your_importer:load_csv", str(tmp_path), "--drive"]
    assert main([*words, "morning", "--out", str(tmp_path / "again")]) == 0
    assert (tmp_path / "again" / "log.json").is_file()
    (tmp_path / "morning" / "ego.csv").write_text("time_us,x,y\n0,1,2")
    assert main([*words, "morning", "--out", str(tmp_path / "never")]) == 2
    [line] = capsys.readouterr().err.splitlines()
    assert "ego.csv: table: cannot be read" in line and "heading" in line


def test_the_agent_can_be_named(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.syspath_prepend(EXAMPLES.parent)
    assert importlib.util.find_spec("examples.navsim_agent") is not None
    planner = make_planner("navsim:examples.navsim_agent:Coasting")
    assert planner.name == "coasting" and planner.needs_images
