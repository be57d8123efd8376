"""The closed-loop grid at its smallest: planners that read states, so nothing is rendered."""

from __future__ import annotations

import json
import os
import shutil
import subprocess
import sys
from pathlib import Path
from typing import Any

import pyarrow.parquet as pq
import pytest

from recast.cli.main import main
from recast.core import Store
from recast.core.errors import InputError
from recast.studies import BenchScene, parse_scenes

TESTS = Path(__file__).parents[1]
FILES = ("rollouts.parquet", "results.json", "bench.json")
OPTIONS = ("--motions", "advancing-a", "stationary-a", "--steps", "10", "--samples", "200")


def command(scenes: list[str], out: Path, *more: str) -> list[str]:
    planner = () if "--planner" in more else ("--planner", "idm-follower")
    words = ["bench", "closed-loop", "--scenes", *scenes, "--out", str(out)]
    return [*words, *OPTIONS, *planner, *more]


@pytest.fixture(scope="module")
def logs(tiny_log_folder: Path, tmp_path_factory: pytest.TempPathFactory) -> list[str]:
    """Two scenes: both vehicles of the tiny drive."""
    return [f"{tiny_log_folder}:0", f"{tiny_log_folder}:1"]


@pytest.fixture(scope="module")
def finished(logs: list[str], tmp_path_factory: pytest.TempPathFactory) -> Path:
    out = tmp_path_factory.mktemp("bench") / "grid"
    assert main(command(logs, out)) == 0
    return out


def rows(out: Path) -> list[dict[str, object]]:
    found: list[dict[str, object]] = pq.read_table(out / "rollouts.parquet").to_pylist()
    return found


def test_every_rollout_is_a_row_and_a_refused_one_says_why(finished: Path) -> None:
    found = rows(finished)
    assert len(found) == 2 * 2 * 2
    assert [r["arm"] for r in found[:2]] == ["native", "replaced"]
    refused = [r for r in found if r["failure"] is not None]
    assert {r["motion"] for r in refused} == {"stationary"}  # the recorded road is too short
    assert all("road" in str(r["failure_reason"]) for r in refused)
    for row in found:
        if row["failure"] is None:
            assert (row["steps_run"], row["verdict"]) == (10, "no collision")
            assert row["ttc"] is not None and row["r_c"] is not None


def test_results_have_intervals_and_differences(finished: Path) -> None:
    results = json.loads((finished / "results.json").read_text())
    assert [line["arm"] for line in results["table"]] == ["native", "replaced"]
    assert all(line["intervals"]["nc"]["mean"] == 100.0 for line in results["table"])
    ttc = next(d for d in results["differences"] if d["metric"] == "ttc")
    # nothing looks at the pictures, so the arms cannot differ
    assert (ttc["candidate"], ttc["baseline"]) == ("replaced", "native")
    assert (ttc["sampled"]["point"], ttc["exact"]["low"], ttc["exact"]["high"]) == (0.0, 0.0, 0.0)
    assert results["failed"] == len(results["failures"]) > 0


def test_nothing_was_rendered_and_times_are_apart(finished: Path) -> None:
    run = next((finished / "scenes").iterdir())
    assert sorted(path.name for path in run.iterdir()) == ["metrics.json", "rollouts", "run.json"]
    assert sorted(path.name for path in (finished.parent / "store").iterdir()) == [
        "rollouts",
        "store.json",
        "users",
    ]
    times = json.loads((finished / "times.json").read_text())
    assert times["all"]["shares"]["render"] == 0.0
    assert times["all"]["rollouts"] == times["sessions"][0]["rollouts"] > 0
    assert "seconds" not in (finished / "results.json").read_text()


def test_a_second_time_makes_nothing_and_changes_nothing(
    finished: Path, logs: list[str], tmp_path: Path
) -> None:
    for name in ("grid", "store"):
        shutil.copytree(finished.parent / name, tmp_path / name, symlinks=True)
    copy = tmp_path / "grid"
    states = list((tmp_path / "store").rglob("rollout.parquet"))
    before = {p: p.stat().st_mtime_ns for p in states}
    assert main(command(logs, copy)) == 0
    assert before == {p: p.stat().st_mtime_ns for p in states} != {}
    for name in FILES:
        assert (copy / name).read_bytes() == (finished / name).read_bytes(), name


def test_another_grid_takes_what_the_store_has(finished: Path, logs: list[str]) -> None:
    out = finished.parent / "other"
    rollouts = finished.parent / "store" / "rollouts"
    before = set(rollouts.iterdir())
    more = ("--planner", "idm-follower", "--planner", "constant-velocity")
    assert main(command(logs[:1], out, *more)) == 0
    times = json.loads((out / "times.json").read_text())
    assert times["all"]["rollouts"] == 2  # of constant-velocity, native and replaced
    assert set(rollouts.iterdir()) > before
    found = rows(out)
    assert [r["planner"] for r in found[:4]] == ["idm-follower"] * 2 + ["constant-velocity"] * 2
    results = json.loads((out / "results.json").read_text())
    assert [(x["planner"], x["arm"]) for x in results["table"]][:2] == [
        ("idm-follower", "native"),
        ("idm-follower", "replaced"),
    ]
    assert {one["planner"] for one in results["differences"]} == {
        "idm-follower",
        "constant-velocity",
    }


@pytest.mark.whole
def test_two_workers_give_the_same_bytes(finished: Path, logs: list[str], tmp_path: Path) -> None:
    assert main(command(logs, tmp_path / "grid", "--workers", "2")) == 0
    for name in FILES:
        assert (tmp_path / "grid" / name).read_bytes() == (finished / name).read_bytes(), name


@pytest.mark.whole
def test_a_killed_grid_goes_on(finished: Path, logs: list[str], tmp_path: Path) -> None:
    out = tmp_path / "grid"
    args = command(logs, out, "--planner", "support.own_parts:Kills")
    environment = {
        **os.environ,
        "RECAST_TEST_KILLS": str(tmp_path / "begun"),
        "PYTHONPATH": str(TESTS),
        "OMP_NUM_THREADS": "1",
    }

    def go() -> int:
        code = "import sys; from recast.cli.main import main; sys.exit(main(sys.argv[1:]))"
        done = subprocess.run([sys.executable, "-c", code, *args], env=environment, check=False)
        return done.returncode

    assert go() == -9
    assert not (out / "results.json").exists()
    kept = {p: p.stat().st_mtime_ns for p in tmp_path.rglob("rollout.parquet")}
    assert kept
    assert go() == 0
    assert {p: p.stat().st_mtime_ns for p in kept} == kept
    # the same planner, if it had not been killed
    assert (out / FILES[0]).read_bytes() == (finished / FILES[0]).read_bytes()


@pytest.mark.parametrize(
    ("planner", "reason"),
    [("Faulty", "no idea"), ("NotANumber", "NaN"), ("TooFew", "expected (40, 3)")],
)
def test_a_failing_planner_is_rows_with_a_reason(
    logs: list[str], tmp_path: Path, planner: str, reason: str, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.syspath_prepend(str(TESTS))
    out = tmp_path / "grid"
    assert main(command(logs[:1], out, "--planner", f"support.own_parts:{planner}")) == 0
    found = [r for r in rows(out) if r["motion"] == "advancing"]
    assert len(found) == 2
    assert all(reason in str(r["failure_reason"]) for r in found)


def test_a_slow_planner_is_rows_with_a_reason(logs: list[str], tmp_path: Path) -> None:
    out = tmp_path / "grid"
    motion = ("--motions", "advancing-a")
    assert main(command(logs[:1], out, *motion, "--plan-timeout", "1e-9")) == 0
    assert all("limit" in str(r["failure_reason"]) for r in rows(out) if r["motion"] == "advancing")


def test_a_scene_that_fails_is_rows_and_the_others_go_on(
    logs: list[str], tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    from recast.studies import schedule

    opened = schedule.SceneRun

    def only_the_first(store: Store, scene: BenchScene, *more: Any) -> object:
        if scene.id.endswith("-1"):
            raise RuntimeError("the disk forgot it")
        return opened(store, scene, *more)

    monkeypatch.setattr(schedule, "SceneRun", only_the_first)
    out = tmp_path / "grid"
    assert main(command(logs, out)) == 0
    found = rows(out)
    assert [r["failure_reason"] for r in found[4:]] == ["the disk forgot it"] * 4
    assert found[0]["failure"] is None
    [note] = out.glob("scenes/*.failure.json")
    assert "in only_the_first" in json.loads(note.read_text())["traceback"]
    monkeypatch.undo()
    assert main(command(logs, out)) == 0
    assert not note.exists()


BAD = [
    (["--scenes", "moonbase"], "moonbase"),
    (["--scenes", "urban-straight", "urban-straight:0"], "twice"),
    (["--scenes", "urban-straight:x"], "seed"),
    (["--scenes", "underpass", "--arm", "warp"], "warp"),
    (["--scenes", "underpass", "--planner", "psychic"], "psychic"),
    (["--scenes", "underpass", "--workers", "0"], "workers"),
    (["--scenes", "underpass", "--seconds", "99"], "seconds"),
    (["--scenes", "underpass", "--cameras", "periscope"], "periscope"),
    (["--scenes", "underpass", "--motions", "moonwalk"], "moonwalk"),
]


@pytest.mark.parametrize(("options", "word"), BAD)
def test_bad_input_is_one_line_before_anything_is_written(
    tmp_path: Path, capsys: pytest.CaptureFixture[str], options: list[str], word: str
) -> None:
    out = tmp_path / "grid"
    try:
        code = main(["bench", "closed-loop", *options, "--out", str(out)])
    except SystemExit as refused:  # by the reader of the command line
        code = int(str(refused.code))
    assert code == 2
    assert word in capsys.readouterr().err
    assert not out.exists()


def test_the_oracle_of_a_recorded_log_is_refused(
    logs: list[str], tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    assert main(command(logs, tmp_path / "grid", "--arm", "native", "--arm", "oracle")) == 2
    assert "synthetic" in capsys.readouterr().err
    assert not (tmp_path / "grid").exists()


def test_another_grid_in_the_folder_is_refused(
    finished: Path, logs: list[str], capsys: pytest.CaptureFixture[str]
) -> None:
    before = {p: p.read_bytes() for p in finished.iterdir() if p.is_file()}
    assert main(command(logs, finished, "--seed", "4")) == 2
    line = capsys.readouterr().err
    assert "config.scene.seed" in line or "config.seed" in line
    assert main(command(logs[:1], finished)) == 2
    assert before == {p: p.read_bytes() for p in finished.iterdir() if p.is_file()}


def test_scenes_by_word(tiny_log_folder: Path) -> None:
    assert len(parse_scenes(["synthetic"], 3)) == 9
    one, two = parse_scenes(["underpass:5", str(tiny_log_folder)], 3, track="1")
    assert (one.id, one.seed, two.track) == ("underpass-5", 5, "1")
    with pytest.raises(InputError, match="LOG:TRACK"):
        parse_scenes([str(tiny_log_folder)], 0)
    with pytest.raises(InputError, match="track 9"):
        parse_scenes([f"{tiny_log_folder}:9"], 0)


def test_the_noise_floor_of_a_planner_that_reads_states(
    logs: list[str], tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Only the start can change what it does, and its start is no other script."""
    monkeypatch.setattr("recast.studies.closed_loop.world_of", lambda _: None)
    out = tmp_path / "grid"
    assert main(command(logs[:1], out, "--arm", "oracle:start", "--arm", "oracle")) == 0
    assert main(command(logs[:1], tmp_path / "all", "--arm", "oracle", "--arm", "noise-floor")) == 0
    for found in (out, tmp_path / "all"):
        driven = [row for row in rows(found) if row["motion"] == "advancing"]
        assert all(row["failure"] is None for row in driven)
        start, truth = (
            next(row for row in driven if row["arm"] == arm) for arm in ("oracle:start", "oracle")
        )
        assert start["r_c_projection"] != truth["r_c_projection"]
        assert (start["oracle_verdict"], start["verdict_agrees"]) == ("no collision", True)
    results = json.loads((tmp_path / "all" / "results.json").read_text())
    [floor] = results["noise_floors"]
    assert (floor["arm"], floor["pairs"], floor["agreeing"]) == ("noise floor", 4, 4)
    assert {(one["noise_floor"], one["share_of_floor"]) for one in results["truth"]} == {(1.0, 1.0)}
    assert results["decomposition"] == []
