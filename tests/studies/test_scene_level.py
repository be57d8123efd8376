"""`recast bench scene-level` at its smallest: two vehicles of the tiny drive, two arms."""

from __future__ import annotations

import json
import os
import shutil
import subprocess
import sys
from pathlib import Path

import numpy as np
import pyarrow.parquet as pq
import pytest
import torch
from PIL import Image

from recast.cli.main import main
from recast.metrics.scene_level_images import load_features
from recast.splats import write_ply
from support.crops import two_coloured_box

FILES = ("scene_level.parquet", "results.json", "table.md", "bench.json", "figure_advancing.png")


OPTIONS = (
    "--motions advancing-a --steps 10 --samples 200 --frechet-samples 20 --iterations 4 "
    "--scale 0.5 --refine False --least-px 4 --every 2"
)


@pytest.fixture(scope="module")
def vehicle(tmp_path_factory: pytest.TempPathFactory) -> str:
    path = tmp_path_factory.mktemp("vehicle") / "box.ply"
    write_ply(path, two_coloured_box())
    return str(path)


def command(log: Path, out: Path, vehicle: str, *more: str) -> list[str]:
    arms = ["--arm", "native", "--arm", vehicle]
    words = ["bench", "scene-level", "--scenes", f"{log}:0", "--out", str(out), *arms]
    return [*words, *OPTIONS.split(), *more]


@pytest.fixture(scope="module")
def finished(tiny_log_folder: Path, vehicle: str, tmp_path_factory: pytest.TempPathFactory) -> Path:
    out = tmp_path_factory.mktemp("level") / "grid"
    assert main(command(tiny_log_folder, out, vehicle)) == 0
    return out


def test_every_arm_is_judged_on_the_same_images(finished: Path) -> None:
    rows = pq.read_table(finished / "scene_level.parquet").to_pylist()
    by_arm = {
        arm: [
            {k: r[k] for k in ("step", "camera", "left", "top", "right", "bottom")}
            for r in rows
            if r["arm"] == arm
        ]
        for arm in ("native", "box.ply")
    }
    assert by_arm["native"] == by_arm["box.ply"]
    assert {row["step"] % 2 for row in by_arm["native"]} == {0}
    assert all(r["drawn"] and r["clip_veh"] is None for r in rows)


def test_the_table_has_arms_control_and_what_is_missing_is_absent(finished: Path) -> None:
    results = json.loads((finished / "results.json").read_text())
    assert [row["arm"] for row in results["table"]] == ["native", "box.ply", "log-replay"]
    values = results["table"][1]["values"]
    assert values.keys() == {"fd_scene_toy", "fd_crop_toy"}
    assert results["networks"] == {}
    assert results["failures"] == {}
    images = next(iter(results["images"].values()))
    assert images["frames"] == results["table"][0]["images"] > 2
    assert 0 < images["compared"] <= 16 < images["references"] or images["references"] <= 16
    text = (finished / "table.md").read_text()
    assert "paper:" not in text  # none of its columns is there
    assert "covariances lack full rank" in text


def test_features_and_figure_are_there(finished: Path) -> None:
    found = sorted(path.parent.name for path in (finished / "features").glob("*/*.npz"))
    assert found == ["box.ply", "log-replay", "native", "references"]
    one, other = (
        load_features(next((finished / "features" / arm).iterdir()))
        for arm in ("native", "box.ply")
    )
    assert np.abs(np.asarray(one["crop_toy"]) - np.asarray(other["crop_toy"])).max() > 0.01
    figure = np.asarray(Image.open(finished / "figure_advancing.png"))
    assert figure.shape[1] == 2 * 364 - 4 and figure.std() > 20


@pytest.mark.whole
def test_another_number_of_workers_and_a_kill_change_no_byte(
    finished: Path, tiny_log_folder: Path, vehicle: str, tmp_path: Path
) -> None:
    out = tmp_path / "grid"
    shutil.copytree(finished.parent / "store", out.parent / "store")
    shutil.rmtree(out.parent / "store" / "evaluations")
    words = command(tiny_log_folder, out, vehicle, "--workers", "2")
    run = [sys.executable, "-c", f"from recast.cli.main import main; main({words!r})"]
    process = subprocess.Popen(run, stdout=subprocess.PIPE, start_new_session=True)
    features = out.parent / "store" / "evaluations"
    while process.poll() is None:  # until the first features are there
        if len(list(features.glob("[!.]*/data/*"))) >= 3:
            os.killpg(process.pid, 9)
            break
    process.communicate()
    made = {path: path.stat().st_mtime_ns for path in (out.parent / "store").rglob("artefact.json")}
    assert made
    assert main(words) == 0
    assert {path: path.stat().st_mtime_ns for path in made} == made
    for name in FILES:
        assert (out / name).read_bytes() == (finished / name).read_bytes(), name


def test_bad_input_is_one_line(
    finished: Path,
    tiny_log_folder: Path,
    vehicle: str,
    tmp_path: Path,
    capsys: pytest.CaptureFixture[str],
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    monkeypatch.setenv("RECAST_WEIGHTS", str(tmp_path / "weights"))
    torch.save({"classifier.weight": torch.zeros(2, 2)}, tmp_path / "other.pth")
    cases = {
        ("--every", "0"): "--every: value: is 0",
        ("--references", "0"): "--references: value: is 0",
        ("--inception", str(tmp_path / "none.pth")): "none.pth: does not exist",
        ("--lpips-weights", str(tmp_path / "other.pth")): "other.pth: ",
        ("--vqa", "nothing"): "VQA scorer: nothing: is not known",
        ("--clip", "clip-vit-l14"): "run `recast weights get clip-vit-l14`",
        ("--arm", "oracle"): "synthetic",
        ("--least-px", "5000"): "none could be measured",
    }
    for words, said in cases.items():
        out, store = tmp_path / "grid", str(finished.parent / "store")
        assert main(command(tiny_log_folder, out, vehicle, *words, "--store", store)) == 2
        assert said in capsys.readouterr().err
        assert (out / "features").exists() is False
        shutil.rmtree(out, ignore_errors=True)
    other = command(tiny_log_folder, finished, vehicle, "--crop", "masked")
    assert main(other) == 2
    assert "the folder contains other work" in capsys.readouterr().err
