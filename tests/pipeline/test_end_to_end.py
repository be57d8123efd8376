"""The whole job on a made-up drive: log to report, twice, with the same bytes."""

from __future__ import annotations

import json
import shutil
from pathlib import Path

import pytest

from recast.cli.main import main
from recast.reporting.video import read_video


def run(log: Path, out: Path) -> int:
    args = ["run", str(log), "--track", "0", "--out", str(out), "--motion", "advancing-a"]
    args += ["--motion", "stationary-a", "--steps", "10", "--iterations", "30", "--scale", "1"]
    return main([*args, "--threads", "1"])


@pytest.fixture(scope="module")
def finished(tiny_log_folder: Path, tmp_path_factory: pytest.TempPathFactory) -> Path:
    out = tmp_path_factory.mktemp("runs") / "run"
    assert run(tiny_log_folder, out) == 0
    return out


def test_everything_is_there(finished: Path) -> None:
    metrics = json.loads((finished / "metrics.json").read_text())
    assert [r["method"] for r in metrics["rollouts"]] == ["native", "replaced"]
    # The recorded road is too short for the standing car: rows with a reason, not a crash.
    assert len(metrics["failures"]) == 2
    assert all("recorded road" in row["reason"] for row in metrics["failures"])
    assert metrics["actor"]["registration"]["after"]["median"] < 0.15
    assert metrics["scene"]["psnr"] > 15
    page = (finished / "report" / "index.html").read_text()
    assert "recorded road" in page and "Of what the cameras showed of the replaced actor" in page
    for method in ("native", "replaced"):
        film = finished / "rollouts" / "advancing-a" / method / "image_02.mp4"
        frames, fps = read_video(film)
        assert len(frames) == 10
        assert fps == pytest.approx(10)
        assert frames.std() > 20, "the picture shows something"


def test_the_methods_differ_in_the_picture_and_not_in_the_motion(finished: Path) -> None:
    metrics = json.loads((finished / "metrics.json").read_text())
    native, replaced = ({**r, "method": "", "name": ""} for r in metrics["rollouts"])
    assert native.pop("coverage") is None
    coverage = replaced.pop("coverage")
    assert coverage["planner"] is None  # it looks at no images
    shown = coverage["all"]
    assert (shown["images"], shown["visible"]) == (2, 2)
    assert shown["seen"] + shown["mirrored"] + shown["invented"] == pytest.approx(1)
    assert native == replaced
    films = [
        read_video(finished / "rollouts" / "advancing-a" / method / "image_02.mp4")[0]
        for method in ("native", "replaced")
    ]
    assert (films[0] != films[1]).any()


def test_a_second_run_gives_the_same_bytes(
    finished: Path, tiny_log_folder: Path, tmp_path: Path
) -> None:
    assert run(tiny_log_folder, tmp_path / "again") == 0
    for name in ("metrics.json", "scene/background.ply", "actor/actor.json"):
        assert (tmp_path / "again" / name).read_bytes() == (finished / name).read_bytes(), name


def test_what_was_lost_is_made_again_and_nothing_else(
    finished: Path, tiny_log_folder: Path, tmp_path: Path
) -> None:
    copy = tmp_path / "copy"
    shutil.copytree(finished, copy)
    shutil.rmtree(copy / "rollouts" / "advancing-a" / "replaced")
    (copy / "metrics.json").unlink()
    kept = copy / "rollouts" / "advancing-a" / "native" / "image_02.mp4"
    before = kept.stat().st_mtime_ns
    assert run(tiny_log_folder, copy) == 0
    assert (copy / "metrics.json").read_bytes() == (finished / "metrics.json").read_bytes()
    assert kept.stat().st_mtime_ns == before
