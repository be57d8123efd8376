"""The whole job on a made-up drive: log to report, twice, with the same bytes."""

from __future__ import annotations

import json
import shutil
from pathlib import Path

import pytest

from recast.cli.main import main
from recast.reporting.video import read_video

pytestmark = pytest.mark.whole


def run(log: Path, out: Path) -> int:
    args = ["run", str(log), "--track", "0", "--out", str(out), "--motion", "advancing-a"]
    args += ["--motion", "stationary-a", "--steps", "10", "--iterations", "30", "--scale", "1"]
    return main([*args, "--planner", "idm-follower", "--threads", "1"])


@pytest.fixture(scope="module")
def finished(tiny_log_folder: Path, tmp_path_factory: pytest.TempPathFactory) -> Path:
    out = tmp_path_factory.mktemp("runs") / "run"
    assert run(tiny_log_folder, out) == 0
    return out


def rollout(run: Path, arm: str) -> Path:
    return run / "rollouts" / "advancing-a" / "idm-follower" / arm


def test_everything_is_there(finished: Path) -> None:
    metrics = json.loads((finished / "metrics.json").read_text())
    assert [r["arm"] for r in metrics["rollouts"]] == ["native", "replaced"]
    # The recorded road is too short for the standing car: rows with a reason, not a crash.
    assert len(metrics["failures"]) == 2
    assert all("recorded road" in row["reason"] for row in metrics["failures"])
    assert metrics["actors"]["replaced"]["registration"]["after"]["median"] < 0.15
    assert metrics["scenes"]["recast"]["psnr"] > 15
    page = (finished / "report" / "index.html").read_text()
    assert "recorded road" in page and "Of the replaced vehicle that the cameras showed" in page
    for arm in ("native", "replaced"):
        frames, fps = read_video(rollout(finished, arm) / "image_02.mp4")
        assert len(frames) == 10
        assert fps == pytest.approx(10)
        assert frames.std() > 20, "the picture shows something"


def test_the_arms_differ_in_the_picture_and_not_in_the_motion(finished: Path) -> None:
    metrics = json.loads((finished / "metrics.json").read_text())
    native, replaced = ({**r, "arm": "", "name": ""} for r in metrics["rollouts"])
    assert native.pop("coverage") is None
    coverage = replaced.pop("coverage")
    assert coverage["planner"] is None  # it looks at no images
    shown = coverage["all"]
    assert (shown["images"], shown["visible"]) == (2, 2)
    assert shown["seen"] + shown["mirrored"] + shown["invented"] == pytest.approx(1)
    assert native == replaced
    films = [
        read_video(rollout(finished, arm) / "image_02.mp4")[0] for arm in ("native", "replaced")
    ]
    assert (films[0] != films[1]).any()


def test_links_lead_to_the_artefacts(finished: Path) -> None:
    for name in (
        "scenes/recast/scene.json",
        "evaluations/recast/eval.json",
        "registered/replaced/observation/crop.png",
        "actors/replaced/actor/actor.json",
        "turntables/replaced/turntable.mp4",
    ):
        assert (finished / name).is_file(), name
    # Refused rollouts are artefacts, too: nobody asks for them twice.
    refused = finished / "rollouts" / "stationary-a" / "idm-follower" / "native"
    assert "recorded road" in (refused / "failure.json").read_text()


def test_a_second_run_gives_the_same_bytes(
    finished: Path, tiny_log_folder: Path, tmp_path: Path
) -> None:
    """In a store of its own, so that nothing is found there."""
    again = tmp_path / "again"
    assert run(tiny_log_folder, again) == 0
    names = ("scenes/recast/background.ply", "actors/replaced/actor/actor.json", "metrics.json")
    for name in names:
        assert (again / name).read_bytes() == (finished / name).read_bytes(), name
    assert sorted(artefacts(again)) == sorted(artefacts(finished))


def artefacts(run: Path) -> dict[str, int]:
    """References of all artefacts in the store beside a run, and when each was made."""
    records = (run.parent / "store").glob("*/*/artefact.json")
    return {f"{p.parts[-3]}/{p.parts[-2]}": p.stat().st_mtime_ns for p in records}


def test_what_was_lost_is_made_again_and_nothing_else(
    finished: Path, tiny_log_folder: Path, tmp_path: Path
) -> None:
    shutil.copytree(finished.parent, tmp_path / "copy", symlinks=True)
    copy = tmp_path / "copy" / finished.name
    before = artefacts(copy)
    lost = rollout(copy, "replaced").resolve().parent
    shutil.rmtree(lost)
    (copy / "metrics.json").unlink()
    assert run(tiny_log_folder, copy) == 0
    assert (copy / "metrics.json").read_bytes() == (finished / "metrics.json").read_bytes()
    after = artefacts(copy)
    assert after.keys() == before.keys()
    assert {name for name in after if after[name] != before[name]} == {f"rollouts/{lost.name}"}
