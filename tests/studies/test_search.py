"""A search at its smallest: planners that read states, so nothing is rendered."""

from __future__ import annotations

import json
import re
import shutil
import sqlite3
import subprocess
import sys
from pathlib import Path
from typing import Any

import pyarrow.parquet as pq
import pytest

from recast.cli.main import main
from recast.core.errors import InputError
from recast.logs import write_log
from recast.simulation import parse_motions
from recast.studies.designs import Design, parse_axis
from recast.studies.study_database import SearchLine, StudyDatabase
from support.synthetic_drives import drive

TESTS = Path(__file__).parents[1]
OPTIONS = ("--steps", "40", "--motion", "cut-in-a", "--trials", "20")
RANGES = ("--over", "gap=2:40", "--over", "initial_speed=0.3:1.0")


def command(log: Path, out: Path, *more: str, ranges: tuple[str, ...] = RANGES) -> list[str]:
    planner = () if "--planner" in more else ("--planner", "idm-follower")
    return ["search", f"{log}:7", "--out", str(out), *OPTIONS, *planner, *ranges, *more]


@pytest.fixture(scope="module")
def log(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A straight drive without sensors."""
    out = tmp_path_factory.mktemp("drive") / "log"
    write_log(drive(10.0, 15.0), out)
    return out


@pytest.fixture(scope="module")
def finished(log: Path, tmp_path_factory: pytest.TempPathFactory) -> Path:
    out = tmp_path_factory.mktemp("search") / "study"
    assert main(command(log, out, "--arm", "native")) == 0
    return out


def trials(out: Path) -> list[dict[str, Any]]:
    found: list[dict[str, Any]] = pq.read_table(out / "trials.parquet").to_pylist()
    return found


def test_every_trial_is_a_row_with_its_margin_and_what_a_driver_needs(finished: Path) -> None:
    rows = trials(finished)
    assert [row["trial"] for row in rows] == list(range(20))
    assert {row["planner"] for row in rows} == {"idm-follower"}
    for row in rows:
        assert 2.0 <= row["gap"] <= 40.0 and row["failure"] is None
        fails = row["margin"] < 0
        assert fails == (row["metric_nc_at_fault"] == 0.0)
        assert (row["metric_contact_speed"] > 0) >= fails
    assert {row["margin"] < 0 for row in rows} == {True, False}
    assert {row["driver_fair"] for row in rows} == {True, False}


def test_the_answer_is_a_boundary_with_intervals(finished: Path) -> None:
    results = json.loads((finished / "results.json").read_text())
    [line] = results["lines"]
    assert line["trials"] + line["beyond_any_driver"] == 20
    assert line["found"].startswith("fails below gap ")
    assert line["share_low"] <= line["share"] <= line["share_high"]
    assert results["boundary"]
    for row in results["boundary"]:
        assert row["low"] <= row["gap"] <= row["high"]
        assert row["fails"] == "below"


def test_examples_are_scenario_files_and_the_page_shows_them(finished: Path) -> None:
    files = sorted((finished / "scenarios").iterdir())
    page = (finished / "index.html").read_text()
    assert files and "<svg" in page
    for file in files:
        [motion] = parse_motions(str(file))
        assert motion.name == "cut-in"
        assert f"scenarios/{file.name}" in page


def test_a_second_time_tries_nothing_and_changes_nothing(
    finished: Path, log: Path, tmp_path: Path
) -> None:
    for name in (finished.name, "store"):
        shutil.copytree(finished.parent / name, tmp_path / name, symlinks=True)
    again = tmp_path / finished.name
    before = {p: p.stat().st_mtime_ns for p in (tmp_path / "store").rglob("rollout.parquet")}
    shown = {name: (again / name).read_bytes() for name in ("results.json", "trials.parquet")}
    assert main(command(log, again, "--arm", "native")) == 0
    assert before == {
        p: p.stat().st_mtime_ns for p in (tmp_path / "store").rglob("rollout.parquet")
    }
    for name, content in shown.items():
        assert (again / name).read_bytes() == content, name


def test_more_trials_go_on_with_the_same_study(finished: Path, log: Path, tmp_path: Path) -> None:
    shutil.copytree(finished, tmp_path / finished.name)
    out = tmp_path / finished.name
    assert main([*command(log, out, "--arm", "native"), "--trials", "24"]) == 0
    rows = trials(out)
    assert len(rows) == 24 and rows[:20] == trials(finished)


def test_another_study_is_refused_in_folder_and_database(
    finished: Path, log: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    other = command(log, finished, "--arm", "native", "--objective", "collision")
    assert main(other) == 2
    assert "search.json: objective: differs" in capsys.readouterr().err
    shared = ("--database", str(finished / "search.db"), "--study", finished.name)
    elsewhere = command(log, tmp_path / "x", "--arm", "native", "--seed", "4", *shared)
    assert main(elsewhere) == 2
    assert "contains another study" in capsys.readouterr().err


@pytest.mark.parametrize(
    ("more", "problem"),
    [
        (("--over", "gap=9:2"), "gap=9:2: is an empty range"),
        (("--over", "gap=2:900"), "gap: is 900"),
        (("--over", "width=1:2"), "has no setting width"),
        (("--over", "seed=0:9"), "seed: has no range"),
        (("--set", "gap=3"), "gap: is varied, too"),
        (("--set", "delay"), "is no setting with a number"),
        (("--set", "delay=-1"), "delay: is negative"),
        (("--motion", "log-replay"), "has no setting gap"),
        (("--objective", "comfort"), "comfort: is not known"),
        (("--design", "bisect"), "bisects along one range, but 2 are given"),
        (("--trials", "3"), "3 are too few"),
        (("--database", "nosuch://host/db"), "database: cannot be opened"),
        (("--database", "/nonexistent/folder/search.db"), "database: cannot be used"),
    ],
)
def test_a_wrong_option_is_one_line(
    more: tuple[str, ...],
    problem: str,
    log: Path,
    tmp_path: Path,
    capsys: pytest.CaptureFixture[str],
) -> None:
    kept = RANGES if more[0] != "--over" else ()
    assert main(command(log, tmp_path / "out", *more, ranges=kept)) == 2
    told = capsys.readouterr().err
    assert problem in " ".join(told.split())
    assert "Traceback" not in told


def test_a_log_that_the_planner_cannot_drive_is_told(
    log: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    assert main(command(log, tmp_path / "out", "--planner", "gtrs-mini")) == 2
    told = " ".join(capsys.readouterr().out.split())
    assert "or a planner that uses no images, such as idm-follower" in told


def test_a_corrupt_database_is_one_line(
    log: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    broken = tmp_path / "search.db"
    broken.write_bytes(b"no database at all, but long enough to be read as one" * 20)
    assert main(command(log, tmp_path / "out", "--database", str(broken))) == 2
    assert "database: cannot be used" in capsys.readouterr().err


def test_a_bisection_of_several_values_and_a_planner_that_fails(log: Path, tmp_path: Path) -> None:
    out = tmp_path / "out"
    planner = "support.own_parts:Faulty"
    ranges = ("--over", "gap=2:40", "--over", "initial_speed=0.4,0.8", "--design", "bisect")
    more = ("--planner", "idm-follower", "--planner", planner, "--arm", "native", "--trials", "6")
    assert main(command(log, out, *more, ranges=ranges)) == 0
    results = json.loads((out / "results.json").read_text())
    follower, faulty = results["lines"]
    assert follower["failed"] == 0 and faulty["failed"] == 12
    assert faulty["found"] == "no trial has a verdict"
    found = [row for row in results["boundary"] if row["planner"] == follower["planner"]]
    assert [row["initial_speed"] for row in found] == [0.4, 0.8]
    assert all(row["high"] - row["low"] < 4 for row in found)
    assert {row["failure"] is None for row in trials(out)} == {True, False}


def test_a_planner_that_samples_is_driven_with_several_seeds(log: Path, tmp_path: Path) -> None:
    out = tmp_path / "out"
    ranges = ("--over", "gap=8,12", "--over", "seed=0,1,2", "--design", "grid")
    planner = ("--planner", "support.own_parts:Sampling", "--planner", "idm-follower")
    assert main(command(log, out, *planner, "--arm", "native", ranges=ranges)) == 0
    rows = trials(out)
    assert len(rows) == 12 and len({row["rollout"] for row in rows}) == 12
    margins = {
        (row["planner"], gap): {
            one["margin"] for one in rows if one["gap"] == gap and one["planner"] == row["planner"]
        }
        for row in rows
        for gap in (8.0, 12.0)
    }
    assert [len(found) for (planner, _), found in sorted(margins.items())] == [1, 1, 3, 3]


def test_impossible_scenarios_are_told_apart(log: Path, tmp_path: Path) -> None:
    out = tmp_path / "out"
    ranges = ("--over", "gap=-8:20", "--design", "grid", "--set", "delay=0")
    motion = ("--motion", "oncoming-a", "--set", "lateral=0")
    words = [*command(log, out, "--arm", "native", ranges=ranges[:4])]
    words[words.index("cut-in-a")] = motion[1]
    assert main([*words, "--trials", "8"]) == 0
    [line] = json.loads((out / "results.json").read_text())["lines"]
    assert line["impossible"] > 0 and line["failed"] == 0
    refused = [row for row in trials(out) if row["refused"]]
    assert any("overlap" in row["failure"] for row in refused)


def test_a_version_that_fails_anew_is_told_and_ends_with_code_1(
    log: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    options = ("--arm", "native", "--design", "sobol", "--trials", "8")
    before, after = tmp_path / "before", tmp_path / "after"
    assert main(command(log, before, *options)) == 0
    planner = ("--planner", "constant-velocity")
    against = ("--compare", str(before), "--most-new")
    capsys.readouterr()
    assert main(command(log, after, *options, *planner, *against, "0.9")) == 0
    told = " ".join(capsys.readouterr().out.split())
    found = re.search(r"(\d+) trials in both studies: (\d+) failures new, 0 gone", told)
    assert found is not None and int(found[2]) > 0 and "new: synthetic-7/" in told
    assert main(command(log, after, *options, *planner, *against, "0")) == 1
    assert main(command(log, before, *options, "--compare", str(after), "--most-new", "0")) == 0
    assert f"0 failures new, {found[2]} gone" in " ".join(capsys.readouterr().out.split())


@pytest.mark.parametrize(
    ("more", "problem"),
    [
        (("--compare", "nowhere"), "trials: are missing"),
        (("--most-new", "0.1"), "--compare: folder: is missing"),
    ],
)
def test_a_wrong_comparison_is_one_line(
    more: tuple[str, ...],
    problem: str,
    log: Path,
    finished: Path,
    capsys: pytest.CaptureFixture[str],
) -> None:
    assert main(command(log, finished, "--arm", "native", *more)) == 2
    assert problem in " ".join(capsys.readouterr().err.split())


def open_book(path: Path) -> StudyDatabase:
    return StudyDatabase(path, "study", {"format": "x"})


DESIGN = Design("boundary", (parse_axis("gap=2:40"),), 20)
LINE = SearchLine("log", "cut-in-a", "p", "native")


def test_two_processes_share_a_batch_and_do_each_trial_once(tmp_path: Path) -> None:
    one = open_book(tmp_path / "s.db").line(LINE, DESIGN, "one")
    other = open_book(tmp_path / "s.db").line(LINE, DESIGN, "other")
    taken: list[tuple[int, str]] = []
    open_trials: dict[str, Any] = {}
    for _ in range(200):
        for name, line in (("one", one), ("other", other)):
            if name in open_trials:
                trial = open_trials.pop(name)
                line.tell(trial, {"margin": trial.point[0] - 11.0})
            elif (trial := line.next()) is not None:
                taken.append((trial.index, name))
                open_trials[name] = trial
        if one.finished and other.finished:
            break
    assert one.finished and other.finished
    assert sorted(index for index, _ in taken) == list(range(20))
    assert {name for _, name in taken} == {"one", "other"}
    alone = open_book(tmp_path / "alone.db").line(LINE, DESIGN, "alone")
    while (trial := alone.next()) is not None:
        alone.tell(trial, {"margin": trial.point[0] - 11.0})
    one.refresh()
    assert [t.point for t in one.trials] == [t.point for t in alone.trials]


def test_what_a_killed_process_had_begun_is_begun_again(tmp_path: Path) -> None:
    killed = open_book(tmp_path / "s.db").line(LINE, DESIGN, "here")
    first = killed.next()
    other = open_book(tmp_path / "s.db").line(LINE, DESIGN, "elsewhere")
    second = other.next()
    assert first is not None and second is not None and first.index != second.index
    again = open_book(tmp_path / "s.db").line(LINE, DESIGN, "here").next()
    assert again is not None and again.index == first.index


def test_two_that_propose_at_once_count_once(tmp_path: Path) -> None:
    one = open_book(tmp_path / "s.db").line(LINE, DESIGN, "one")
    other = open_book(tmp_path / "s.db").line(LINE, DESIGN, "other")
    points = DESIGN.proposals([])
    one._propose(points)
    other._propose(points)
    done = []
    while (trial := one.next()) is not None:
        done.append(trial.index)
        one.tell(trial, {"margin": 1.0})
    assert sorted(done) == list(range(20))


def test_of_another_version_nothing_is_read(tmp_path: Path) -> None:
    open_book(tmp_path / "s.db")
    with pytest.raises(InputError, match="contains another study study: format differs"):
        StudyDatabase(tmp_path / "s.db", "study", {"format": "y"})
    with sqlite3.connect(tmp_path / "s.db") as base:
        base.execute("update alembic_version set version_num = 'v99'")
    with pytest.raises(InputError, match="database: cannot be opened"):
        open_book(tmp_path / "s.db")


@pytest.mark.whole
def test_two_workers_try_the_same(finished: Path, log: Path, tmp_path: Path) -> None:
    assert main(command(log, tmp_path / "study", "--arm", "native", "--workers", "2")) == 0
    assert (tmp_path / "study" / "trials.parquet").read_bytes() == (
        finished / "trials.parquet"
    ).read_bytes()


@pytest.mark.whole
def test_a_study_that_is_killed_again_and_again_ends_the_same(
    finished: Path, log: Path, tmp_path: Path
) -> None:
    out = tmp_path / "study"
    start = "import sys; from recast.cli.main import main; sys.exit(main(sys.argv[1:]))"
    words = [sys.executable, "-c", start, *command(log, out, "--arm", "native")]
    for seconds in (4.0, 5.0, 6.0, 7.0):
        process = subprocess.Popen(words, cwd=TESTS, stdout=subprocess.DEVNULL)
        try:
            process.wait(seconds)
        except subprocess.TimeoutExpired:
            process.kill()
            process.wait()
    subprocess.run(words, cwd=TESTS, check=True, stdout=subprocess.DEVNULL)
    assert trials(out) == trials(finished)
