"""The recipe of the small model, each step for a moment."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
import torch

from recast.recar.training_conditions import read_asset
from recast_tools.small_model.asset_store import ChannelMoments
from recast_tools.small_model.autoencoders import (
    dice_loss,
    side_colours,
    view_azimuths,
    voxel_overlap,
)

pytest.importorskip("embreex")


@pytest.fixture(scope="module")
def assets(tmp_path_factory: pytest.TempPathFactory) -> Path:
    from recast_tools.small_model.asset_synthesis import AssetsRecord, make_assets

    folder = tmp_path_factory.mktemp("assets")
    make_assets(folder, 4, AssetsRecord(seed=9, crops=2, around=2, pixels=64))
    return folder


@pytest.fixture(scope="module")
def parts(assets: Path, tmp_path_factory: pytest.TempPathFactory) -> dict[str, Path]:
    """Trained for a few steps, with the losses on the way."""
    from recast.trellis.vae import SparseStructureEncoder
    from recast_tools.small_model import recipe

    out = tmp_path_factory.mktemp("parts")
    recipe.train_structure(assets, out / "structure", 3, 0, _ignore)
    recipe.train_latent(assets, out / "latent", 3, 0, _ignore)
    from recast_tools.small_model.assemble import structure_encoder

    encoder = structure_encoder(out / "structure")
    assert isinstance(encoder, SparseStructureEncoder)
    recipe.train_image(assets, encoder, out / "image", 3, 0, _ignore)
    return {name: out / name for name in ("structure", "latent", "image")}


def _ignore(step: int, logs: dict[str, float]) -> None:
    del step, logs


def test_losses_of_known_grids() -> None:
    grid = torch.zeros(2, 1, 4, 4, 4)
    grid[:, :, :2] = 1
    sure = (grid * 2 - 1) * 50
    assert float(dice_loss(sure, grid)) < 1e-5
    assert float(dice_loss(-sure, grid)) > 0.95
    moved = torch.zeros_like(grid, dtype=torch.bool)
    moved[:, :, 1:3] = True
    torch.testing.assert_close(voxel_overlap(moved, grid > 0), torch.full((2,), 1 / 3))


def test_azimuth_is_where_the_camera_stands(assets: Path) -> None:
    asset = read_asset(assets / "asset-00000.npz")
    angles = view_azimuths(asset).numpy()
    for angle, pose in zip(angles, asset.poses, strict=False):
        eye = np.linalg.inv(pose.astype(float))[:3, 3]
        np.testing.assert_allclose(np.arctan2(eye[1], eye[0]), angle, atol=1e-5)
    assert len(angles) == 2


def test_sides_have_the_colour_of_what_faces_them(assets: Path) -> None:
    asset = read_asset(assets / "asset-00000.npz")
    features = np.zeros((3, 17), np.float16)
    features[0, :6] = [1, 0, -1, 0.6, 0, 0.8]  # faces ahead and up
    features[1, :6] = [0, 1, 0, 0, -1, 0]  # to the right
    features[2, :6] = [-1, 0, 0.5, 0, 0, 1]  # up
    ahead, rear, left, right, up, _ = side_colours(replace(asset, features=features)).unflatten(
        0, (6, 3)
    )
    np.testing.assert_allclose(ahead, [1, 0, -1], atol=1e-4)
    np.testing.assert_allclose(right, [0, 1, 0], atol=1e-4)
    mixed = (0.64 * features[0, :3] + features[2, :3]) / 1.64
    np.testing.assert_allclose(up, mixed, atol=1e-3)
    for unseen in (rear, left):  # nothing faces them: the mean of all
        np.testing.assert_allclose(unseen, features[:, :3].mean(axis=0), atol=1e-3)


def test_parts_become_a_model_and_its_targets(
    assets: Path, parts: dict[str, Path], tmp_path: Path
) -> None:
    from recast.recar.target_cache import TargetCache
    from recast.trellis import ImageTo3D
    from recast.trellis.checkpoints import first_fault, verify_checkpoint
    from recast_tools.small_model.assemble import assemble

    assemble(assets, parts, tmp_path / "model", tmp_path / "cache")
    assert first_fault(verify_checkpoint(tmp_path / "model", values=True)) is None
    model = ImageTo3D.load(tmp_path / "model")
    cache = TargetCache.open(tmp_path / "cache")
    assert len(cache.ids("train")) == 3
    assert cache.ids("held-out") == ("asset-00000",)
    target = cache.target("asset-00003")
    asset = read_asset(assets / "asset-00003.npz")
    assert np.array_equal(target.coords, asset.coords)
    rows = np.concatenate([cache.target(one).latent for one in cache.ids("train")])
    np.testing.assert_allclose(model.latent_mean, rows.mean(axis=0), atol=1e-4)
    np.testing.assert_allclose(model.latent_std, rows.std(axis=0), rtol=1e-3)


def test_reports_tell_what_was_reached(parts: dict[str, Path]) -> None:
    import json

    reports = {
        name: json.loads((folder / "report.json").read_text()) for name, folder in parts.items()
    }
    assert 0 <= reports["structure"]["vehicles_iou"] <= 1
    assert reports["latent"]["psnr"] > 5
    assert reports["image"].keys() == {"error", "shuffled", "nearest_picture", "mean"}


def test_a_restart_changes_nothing(assets: Path, parts: dict[str, Path], tmp_path: Path) -> None:
    from recast_tools.small_model import recipe

    recipe.train_latent(assets, tmp_path, 3, 0, _ignore)
    name = "ckpts/slat_dec_gs.safetensors"
    assert (tmp_path / name).read_bytes() == (parts["latent"] / name).read_bytes()


def test_moments_are_those_of_all_values_together() -> None:
    moments = ChannelMoments()
    assert moments.statistics() is None
    rng = np.random.default_rng(0)
    parts = [rng.normal(1e4, 2.0, (count, 8)).astype(np.float32) for count in (1, 30, 7)]
    for part in parts:
        moments.add(part)
    found, values = moments.statistics(), np.concatenate(parts).astype(np.float64)
    assert found is not None
    np.testing.assert_allclose(found.mean, values.mean(axis=0), rtol=1e-12)
    np.testing.assert_allclose(found.std, values.std(axis=0), rtol=1e-12)
