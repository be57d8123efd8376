"""The stages of the generation against the golden end-to-end case."""

from __future__ import annotations

from pathlib import Path

import pytest
import torch

from recast.trellis.generate import ImageTo3D
from recast.trellis.sampler import Condition
from support.trellis import AFTER_TIME, assert_same, golden_tensors
from support.trellis_folder import write_golden_model


@pytest.fixture(scope="module")
def model(tmp_path_factory: pytest.TempPathFactory) -> ImageTo3D:
    return ImageTo3D.load(write_golden_model(tmp_path_factory.mktemp("golden") / "model"))


def test_golden_case_from_condition_to_gaussians(model: ImageTo3D) -> None:
    case = golden_tensors("e2e_tiny")
    condition = Condition(case["cond"][None], "stochastic")
    structure = model.sample_structure(case["ss_noise"], condition)
    assert_same(structure, case["z_s"], AFTER_TIME)
    coords = model.active_voxels(structure[0])
    assert torch.equal(coords, case["coords"][:, 1:])
    latent = model.sample_latent([coords], [case["slat_noise"]], condition)
    assert_same(latent.feats, case["slat"], AFTER_TIME)
    (gaussians,) = model.decode(latent)
    assert_same(gaussians.means, case["xyz"], AFTER_TIME)
    assert_same(gaussians.log_scales.exp(), case["scaling"], AFTER_TIME)
    assert_same(gaussians.quats, case["rotation"], AFTER_TIME)
    assert_same(torch.sigmoid(gaussians.logit_opacities)[:, None], case["opacity"], AFTER_TIME)
    assert_same(gaussians.sh, case["features"], AFTER_TIME)


def test_latents_are_denormalised_by_the_statistics_of_the_checkpoint(model: ImageTo3D) -> None:
    case = golden_tensors("e2e_tiny")
    assert_same(
        (case["slat"] - model.latent_mean) / model.latent_std, case["slat_norm"], relative=1e-4
    )


def test_views_are_encoded_by_vehicle_and_position(model: ImageTo3D) -> None:
    torch.manual_seed(0)
    pictures = [_disc(colour) for colour in (40, 90, 140, 220)]
    both = model.condition([pictures[:2], pictures[2:]], ["a", "b"])
    assert both.views.shape == (2, 2, 21, 48)
    for vehicle in range(2):
        alone = model.condition([pictures[2 * vehicle : 2 * vehicle + 2]], ["a"])
        torch.testing.assert_close(both.views[:, vehicle], alone.views[:, 0])


def test_vehicles_need_equally_many_views(model: ImageTo3D) -> None:
    with pytest.raises(ValueError, match="different numbers of views"):
        model.condition([[_disc(50)], [_disc(50), _disc(60)]], ["a", "b"])


def test_limit_of_voxels_is_that_of_the_training_data(model: ImageTo3D) -> None:
    assert model.trained_voxels == 8 * 16**2


def _disc(colour: int):
    import numpy as np

    y, x = np.mgrid[:64, :64]
    inside = (x - 30) ** 2 + (y - 34) ** 2 < 20**2
    image = np.zeros((64, 64, 4), np.uint8)
    image[inside] = [colour, 255 - colour, 60, 255]
    return image


def test_loading_names_a_missing_folder(tmp_path: Path) -> None:
    from recast.core.errors import InputError

    with pytest.raises(InputError, match=r"pipeline\.json"):
        ImageTo3D.load(tmp_path / "nothing")
