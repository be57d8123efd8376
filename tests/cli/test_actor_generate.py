"""`recast actor generate`: from a crop to Gaussians, and one line on bad input."""

from __future__ import annotations

import json
import shutil
from pathlib import Path

import numpy as np
import pytest
import torch
from PIL import Image
from safetensors.torch import load_file, save_file

import recast.runs.actor
from recast.cli.main import main
from recast.reporting.video import read_video
from recast.splats import read_ply
from recast.trellis.conditioning import crop_to_object, read_crop
from recast.trellis.generate import ImageTo3D
from recast.trellis.sampler import Condition
from support.trellis import FOLDER, assert_same
from support.trellis_folder import write_golden_model

CROP = FOLDER / "preprocess_in.png"


def run(capsys: pytest.CaptureFixture[str], *args: str | Path) -> tuple[int, str, str]:
    capsys.readouterr()
    code = main(["actor", "generate", *(str(arg) for arg in args)])
    captured = capsys.readouterr()
    return code, captured.out, captured.err


@pytest.fixture(autouse=True)
def short_films(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(recast.runs.actor, "_TURNTABLE_VIEWS", 12)
    monkeypatch.setattr(recast.runs.actor, "_TURNTABLE_SIZE", (320, 180))


@pytest.fixture(scope="module")
def folder(tmp_path_factory: pytest.TempPathFactory) -> Path:
    return write_golden_model(tmp_path_factory.mktemp("golden") / "model")


def test_from_image_to_gaussians(
    folder: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    """The command gives what the golden-tested stages give one after the other."""
    out = tmp_path / "car"
    code, text, err = run(capsys, CROP, "--model", folder, "--out", out, "--seed", "11")
    assert code == 0, err
    model = ImageTo3D.load(folder)
    pixels = crop_to_object(read_crop(CROP), 56)
    image = torch.from_numpy(pixels).permute(2, 0, 1)[None] / 255
    condition = Condition(model.encoder.encode(image)[None])
    torch.manual_seed(11)
    structure = model.sample_structure(torch.randn(1, 8, 4, 4, 4), condition)
    coords = model.active_voxels(structure[0])
    latent = model.sample_latent([coords], [torch.randn(len(coords), 8)], condition)
    (expected,) = model.decode(latent)
    found = read_ply(out / "vehicle.ply")
    assert_same(found.means, expected.means)
    assert_same(found.log_scales, expected.log_scales)
    assert_same(found.quats, expected.quats)
    assert_same(found.logit_opacities, expected.logit_opacities)
    assert_same(found.sh, expected.sh)
    viewer = read_ply(out / "viewer.ply")
    assert_same(viewer.means[:, 1], -expected.means[:, 2])
    assert np.array_equal(np.asarray(Image.open(out / "condition.png")), pixels)
    frames, _ = read_video(out / "turntable.mp4")
    assert frames.shape == (12, 180, 320, 3)
    assert len({int(frame.astype(int).sum()) for frame in frames}) > 6  # it turns
    record = json.loads((out / "generation.json").read_text())
    assert record["voxels"] == len(coords)
    assert record["seed"] == 11
    assert record["structure"]["steps"] == 6
    assert f"{len(coords)} voxels, {len(expected)} Gaussians, seed 11" in text
    assert "peak memory" in text


def test_several_crops_are_batched_into_folders(
    folder: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    second = tmp_path / "second.png"
    Image.open(CROP).transpose(Image.Transpose.FLIP_LEFT_RIGHT).save(second)
    out = tmp_path / "cars"
    code, _, err = run(
        capsys, CROP, second, "--model", folder, "--out", out, "--steps", "2", "--cfg", "2", "1"
    )
    assert code == 0, err
    assert sorted(p.name for p in out.iterdir()) == ["cost.json", "preprocess_in", "second"]
    record = json.loads((out / "second" / "generation.json").read_text())
    assert (record["structure"]["steps"], record["latent"]["steps"]) == (2, 2)
    assert (record["structure"]["cfg_strength"], record["latent"]["cfg_strength"]) == (2, 1)


def test_views_of_one_vehicle_and_equal_bytes(
    folder: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    second = tmp_path / "rear.png"
    Image.open(CROP).transpose(Image.Transpose.FLIP_LEFT_RIGHT).save(second)
    args = (CROP, "--views", second, "--model", folder, "--steps", "2")
    for name in ("a", "b"):
        code, _, err = run(capsys, *args, "--out", tmp_path / name)
        assert code == 0, err
    for file in ("vehicle.ply", "viewer.ply", "condition.png", "generation.json"):
        assert (tmp_path / "a" / file).read_bytes() == (tmp_path / "b" / file).read_bytes()
    assert Image.open(tmp_path / "a" / "condition.png").size == (112, 56)


def _picture(path: Path, alpha: np.ndarray | None) -> Path:
    pixels = np.full((60, 80, 3 if alpha is None else 4), 90, np.uint8)
    if alpha is not None:
        pixels[..., 3] = alpha
    Image.fromarray(pixels).save(path)
    return path


def test_unusable_crops_are_one_line(
    folder: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    tiny = np.zeros((60, 80), np.uint8)
    tiny[30:33, 40:43] = 255
    cases = {
        "photo.png": (None, "alpha"),
        "clear.png": (np.zeros((60, 80), np.uint8), "zero everywhere"),
        "solid.png": (np.full((60, 80), 255, np.uint8), "opaque"),
        "tiny.png": (tiny, "3"),
    }
    for name, (alpha, word) in cases.items():
        crop = _picture(tmp_path / name, alpha)
        code, _, err = run(capsys, crop, "--model", folder, "--out", tmp_path / "out")
        assert code == 2
        assert err.count("\n") == 1
        assert name in err
        assert word in err
        assert sorted(p.name for p in tmp_path.glob("*out*")) == []


@pytest.mark.parametrize(
    ("change", "message"),
    [
        ("shape", "out_layer.weight"),
        ("truncated", "ss_flow.safetensors"),
        ("missing", "slat_flow"),
        ("nan", "blocks.0.mlp.mlp.0.bias"),
        ("pickle", "ss_dec.safetensors"),
    ],
)
def test_broken_models_are_one_line(
    change: str, message: str, folder: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    broken = tmp_path / "model"
    shutil.copytree(folder, broken)
    flow = broken / "ckpts" / "ss_flow.safetensors"
    if change == "shape":
        save_file({**load_file(flow), "out_layer.weight": torch.zeros(8, 63)}, flow)
    elif change == "truncated":
        flow.write_bytes(flow.read_bytes()[:-1000])
    elif change == "missing":
        (broken / "ckpts" / "slat_flow.safetensors").unlink()
    elif change == "nan":
        weights = load_file(flow)
        weights["blocks.0.mlp.mlp.0.bias"][3] = float("nan")
        save_file(weights, flow)
    else:
        torch.save({"a": torch.zeros(3)}, broken / "ckpts" / "ss_dec.safetensors")
    code, _, err = run(capsys, CROP, "--model", broken, "--out", tmp_path / "out")
    assert code == 2
    assert err.count("\n") == 1
    assert message in err
    assert not (tmp_path / "out").exists()


@pytest.mark.parametrize(
    ("args", "message"),
    [
        (("--steps", "0"), "steps"),
        (("--device", "cuda:77"), "--device"),
        (("--max-voxels", "2"), "at most 2 are allowed"),
        (("--image-encoder", "nowhere"), "nowhere"),
    ],
)
def test_bad_options_are_one_line(
    args: tuple[str, ...],
    message: str,
    folder: Path,
    tmp_path: Path,
    capsys: pytest.CaptureFixture[str],
) -> None:
    code, _, err = run(capsys, CROP, "--model", folder, "--out", tmp_path / "out", *args)
    assert code == 2
    assert err.count("\n") == 1
    assert message in err
    assert not (tmp_path / "out").exists()


def test_views_of_several_crops_are_refused(
    folder: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    other = tmp_path / "other.png"
    shutil.copyfile(CROP, other)
    code, _, err = run(
        capsys, CROP, other, "--views", CROP, "--model", folder, "--out", tmp_path / "out"
    )
    assert code == 2
    assert "--views" in err
