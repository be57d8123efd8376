"""`recast eval actor` with a log: refined actors against held-out images."""

from __future__ import annotations

import json
from pathlib import Path

import pytest

from recast.cli.main import main


@pytest.fixture(scope="module")
def scene(tiny_log_folder: Path, tmp_path_factory: pytest.TempPathFactory) -> Path:
    path = tmp_path_factory.mktemp("scene") / "scene"
    command = ["scene", "train", str(tiny_log_folder), "--out", str(path), "--threads", "1"]
    assert main([*command, "--iterations", "4", "--scale", "0.5", "--force-dynamic", "0"]) == 0
    return path


@pytest.mark.whole
def test_tracks_of_a_log(
    tiny_log_folder: Path, scene: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    out = tmp_path / "out"
    command = ["eval", "actor", "template", str(tiny_log_folder), "--scene", str(scene)]
    assert main([*command, "--track", "0", "--out", str(out)]) == 0
    told = capsys.readouterr().out
    assert "reconstructed" in told and "refined" in told
    (track,) = json.loads((out / "metrics.json").read_text())["tracks"]
    assert track["track_id"] == "0" and track["images"] > 0
    for scores in (track["psnr"], track["ssim"]):
        assert set(scores) == {"reconstructed", "registered", "refined"}
    assert track["provenance"]["refinement"] is not None
    assert (out / "track_0" / "held_out.png").is_file()


@pytest.mark.whole
def test_a_hidden_side(
    tiny_log_folder: Path, scene: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    out = tmp_path / "out"
    command = ["eval", "actor", "template", str(tiny_log_folder), "--scene", str(scene)]
    command += ["--track", "0", "--hide", "1", "--out", str(out)]
    assert main(command) == 0
    told = capsys.readouterr().out
    assert "images 1 degrees from all that were looked at" in told
    assert all(len(line) <= 80 for line in told.splitlines())
    (track,) = json.loads((out / "metrics.json").read_text())["hidden"]
    assert track["kept"] > 0 and track["hidden"] > 0
    for model in ("reconstructed", "replaced", "all images: reconstructed", "all images: replaced"):
        assert set(track["scores"][model]) == {"psnr", "ssim", "mask_iou"}
    assert (out / "track_0" / "hidden.png").is_file()
    assert (out / "track_0" / "street" / "scene.json").is_file()


@pytest.mark.parametrize(
    ("options", "problem"),
    [
        (["--scene", "SCENE", "--track", "0", "--hide", "170"], "is seen over"),
        (["--scene", "SCENE", "--track", "0", "--hide", "0"], "hide"),
        (["--scene", "SCENE"], "--track: tracks: none is given"),
        (["--scene", "SCENE", "--track", "1"], "track 1"),
    ],
)
def test_what_is_missing_is_said(
    tiny_log_folder: Path,
    scene: Path,
    tmp_path: Path,
    capsys: pytest.CaptureFixture[str],
    options: list[str],
    problem: str,
) -> None:
    named = [str(scene) if option == "SCENE" else option for option in options]
    out = tmp_path / "out"
    command = ["eval", "actor", "template", str(tiny_log_folder), *named, "--out", str(out)]
    assert main(command) == 2
    assert problem in capsys.readouterr().err
    assert not out.exists()
