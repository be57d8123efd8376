"""`recast view`: what it takes, and what it says about what it does not."""

from __future__ import annotations

import sys
from pathlib import Path

import pytest

from recast.cli.main import main
from recast.logs import DrivingLog, map_of
from recast.planning import make_planner
from recast.runs.view import view_inputs
from recast.simulation import MOTIONS, RolloutSetup, run_rollout, save_rollout

pytest.importorskip("viser")


@pytest.fixture(scope="module")
def rollout_folder(tiny_log: DrivingLog, tmp_path_factory: pytest.TempPathFactory) -> Path:
    folder = tmp_path_factory.mktemp("loose") / "native"
    setup = RolloutSetup(
        tiny_log, "0", MOTIONS["advancing-a"], arm="native", map=map_of(tiny_log), steps=10
    )
    save_rollout(run_rollout(setup, make_planner("idm-follower")), folder / "states")
    return folder


def refused(capsys: pytest.CaptureFixture[str], *words: str) -> str:
    assert main(["view", *words]) == 2
    said = capsys.readouterr().err
    assert said.count("\n") == 1
    return said


def test_a_log_and_its_rollout_are_shown_together(
    tiny_log_folder: Path, rollout_folder: Path
) -> None:
    found = view_inputs([tiny_log_folder, rollout_folder])
    assert list(found.scenarios) == ["advancing-a, idm-follower", "recording"]
    drive = found.scenarios["advancing-a, idm-follower"]["native"]
    assert drive.controlled == ("0",) and len(drive) == 11
    assert found.runner is not None and found.runner.track == "0"


def test_a_replay_of_a_log_is_written(
    tiny_log_folder: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    path = tmp_path / "log.html"
    assert main(["view", str(tiny_log_folder), "--replay", str(path)]) == 0
    assert path.stat().st_size < 3e6
    said = " ".join(capsys.readouterr().out.split())
    assert "MB, 0 of 0 Gaussians" in said and "viser" not in said


def test_folders_that_cannot_be_shown_are_refused(
    tiny_log_folder: Path, rollout_folder: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    log, nothing = str(tiny_log_folder), str(tmp_path)
    assert "is not a folder" in refused(capsys, str(tmp_path / "missing"))
    assert "is not a folder that can be shown" in refused(capsys, nothing)
    assert "second log" in refused(capsys, log, log)
    assert "outside of a run folder" in refused(capsys, str(rollout_folder))


@pytest.mark.parametrize(
    ("words", "named"),
    [
        (("--max-gaussians", "10"), "--max-gaussians"),
        (("--port", "0"), "--port"),
        (("--replay-mb", "nan", "--replay", "x.html"), "--replay-mb"),
        (("--replay", "x.txt"), "--replay"),
    ],
)
def test_options_are_checked_first(
    words: tuple[str, ...], named: str, capsys: pytest.CaptureFixture[str]
) -> None:
    assert named in refused(capsys, "no-such-folder", *words)


def test_without_viser_one_line_says_what_to_install(
    tiny_log_folder: Path, capsys: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setitem(sys.modules, "viser", None)
    assert "pip install 'recast-sim[viewer]'" in refused(capsys, str(tiny_log_folder))
