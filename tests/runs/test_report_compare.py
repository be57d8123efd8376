"""`recast report` on small runs without images: alone, and side by side."""

from __future__ import annotations

import json
import shutil
from pathlib import Path

import pytest
from rich.console import Console

from recast.cli.main import main
from recast.runs.arms import Arm
from recast.runs.config import RunConfig
from recast.runs.run import run
from support.tiny_street import TINY

TITLE = "Advancing"


def small_run(log: Path, out: Path, **settings: object) -> Path:
    config = RunConfig(
        track="0",
        motions=("advancing-a",),
        arms=(Arm.native(),),
        films=False,
        scene=TINY,
        threads=1,
        **{"steps": 10, **settings},
    )
    run(log, out, config, Console(quiet=True))
    return out


@pytest.fixture(scope="module")
def runs(tiny_log_folder: Path, tmp_path_factory: pytest.TempPathFactory) -> list[Path]:
    folder = tmp_path_factory.mktemp("runs")
    return [
        small_run(tiny_log_folder, folder / "ten"),
        small_run(tiny_log_folder, folder / "other", seed=3),
    ]


def report(*words: str | Path) -> int:
    return main(["report", *(str(word) for word in words)])


def test_runs_are_compared(runs: list[Path], tmp_path: Path) -> None:
    assert report("--compare", *runs, "--out", tmp_path / "both") == 0
    text = (tmp_path / "both/index.html").read_text()
    for words in (
        "2 runs compared",
        "<td>ten</td>",
        "<td>other</td>",
        "<code>seed</code></th><td><code>0</code></td><td><code>3</code></td>",
        "paired; mean over 1 of 1 pair",
        "path within 0.5 m of A",
        f"B: {TITLE}",
    ):
        assert words in text, words
    assert "another log" not in text


def test_runs_of_different_logs_are_compared_and_told(runs: list[Path], tmp_path: Path) -> None:
    other = tmp_path / "other"
    shutil.copytree(runs[1], other, symlinks=True)
    record = json.loads((other / "run.json").read_text())
    for where in ("store", "log"):
        place = record[where]["path"] if where == "log" else record[where]
        there = str((runs[1] / place).resolve())
        record[where] = {"path": there, "hash": "0" * 64} if where == "log" else there
    (other / "run.json").write_text(json.dumps(record))
    assert report("--compare", runs[0], other, "--out", tmp_path / "out") == 0
    assert "B is a run on another log than A" in (tmp_path / "out/index.html").read_text()


@pytest.mark.parametrize(
    ("words", "field"),
    [
        (("--compare", "ten", "--out", "OUT"), "runs: only 1 given"),
        (("--compare", "ten", "eight"), "--out: folder: is missing"),
        (("--compare", "ten", "ten", "--out", "OUT"), "named twice"),
        (("--compare", "ten", "gone", "--out", "OUT"), "gone/run.json"),
        (("--compare", "ten", "empty", "--out", "OUT"), "empty/run.json"),
        (("--compare", "ten", "eight", "--out", "FULL"), "not part of a report"),
        (("ten", "eight"), "add --compare"),
        ((), "run folder: 0 are given"),
        (("gone",), "gone/run.json"),
    ],
)
def test_bad_input_is_one_line(
    words: tuple[str, ...],
    field: str,
    runs: list[Path],
    tmp_path: Path,
    capsys: pytest.CaptureFixture[str],
) -> None:
    (tmp_path / "empty").mkdir()
    (tmp_path / "full").mkdir()
    (tmp_path / "full/thesis.txt").write_text("years of work")
    places = {
        "ten": runs[0],
        "eight": runs[1],
        "gone": tmp_path / "gone",
        "empty": tmp_path / "empty",
        "OUT": tmp_path / "out",
        "FULL": tmp_path / "full",
    }
    capsys.readouterr()
    assert report(*(places.get(word, word) for word in words)) == 2
    lines = capsys.readouterr().err.strip().splitlines()
    assert len(lines) == 1 and field in lines[0], lines
    assert not (tmp_path / "out").exists() and not list(tmp_path.glob(".*"))
