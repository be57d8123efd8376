"""From raw channels to Gaussians."""

from __future__ import annotations

import math

import pytest
import torch
from hypothesis import given, settings
from hypothesis import strategies as st
from pydantic import ValidationError

from recast.trellis.vae import (
    RepresentationConfig,
    hammersley,
    offset_perturbation,
    raw_to_gaussians,
    split_raw,
)
from support.trellis import assert_same, golden_config, golden_tensors

PUBLISHED = RepresentationConfig()


def test_hammersley_and_the_published_perturbation() -> None:
    ops = golden_tensors("ops")
    assert_same(hammersley(32), ops["hammersley32"], 1e-7)
    assert_same(offset_perturbation(PUBLISHED), ops["offset_perturbation32_vs1p5"], 1e-6)
    assert hammersley(8)[6, 1] == 0.375  # 110 -> 0.011
    assert hammersley(8)[5, 2] == pytest.approx(7 / 9)  # 12 -> 0.21


@pytest.mark.parametrize("sample", [0, 1])
def test_golden_attributes_from_the_golden_raw_channels(sample: int) -> None:
    io = golden_tensors("slat_dec_gs_io")
    args = golden_config("slat_dec_gs")["args"]
    config = RepresentationConfig.model_validate(args["representation_config"])
    rows = io["coords"][:, 0] == sample
    raw, coords = io["raw"][rows], io["coords"][rows, 1:]
    found = raw_to_gaussians(raw, coords, io["offset_perturbation"], config, args["resolution"])
    found.validate()
    assert_same(found.means, io[f"g{sample}_xyz"])
    assert_same(found.means + 0.5, io[f"g{sample}__xyz"])
    assert_same(found.log_scales.exp(), io[f"g{sample}_scaling"])
    assert_same(found.quats, io[f"g{sample}_rotation"])
    assert_same(found.logit_opacities.sigmoid()[:, None], io[f"g{sample}_opacity"])
    assert_same(found.sh, io[f"g{sample}_features"])
    part = split_raw(raw, config)
    assert_same(part["scale"].flatten(0, 1), io[f"g{sample}__scaling"])
    assert_same(part["rotation"].flatten(0, 1), io[f"g{sample}__rotation"])
    assert_same(part["opacity"].flatten(0, 1), io[f"g{sample}__opacity"])


@settings(max_examples=60, deadline=None)
@given(st.floats(-30, 30), st.integers(0, 2**31), st.integers(1, 64), st.integers(1, 33))
def test_centres_stay_within_three_quarters_of_a_voxel(
    exponent: float, seed: int, resolution: int, count: int
) -> None:
    config = RepresentationConfig(num_gaussians=count)
    generator = torch.Generator().manual_seed(seed)
    raw = torch.randn(5, config.channels, generator=generator) * 10**exponent
    coords = torch.randint(0, resolution, (5, 3), generator=generator)
    found = raw_to_gaussians(raw, coords, offset_perturbation(config), config, resolution)
    centre = ((coords.double() + 0.5) / resolution - 0.5).repeat_interleave(count, dim=0)
    assert float((found.means - centre).abs().max()) <= 0.75 / resolution + 1e-7
    assert float(found.log_scales.min()) >= math.log(9e-4) - 1e-5
    if exponent < 5:  # beyond, standard deviations leave what the rasterizer takes
        found.validate()


def test_raw_zero_gives_the_biases() -> None:
    raw = torch.zeros(1, PUBLISHED.channels)
    found = raw_to_gaussians(
        raw, torch.tensor([[0, 0, 63]]), offset_perturbation(PUBLISHED), PUBLISHED, 64
    )
    corner = torch.tensor([-0.5, -0.5, 0.5 - 1 / 64])  # of the voxel
    assert torch.allclose(found.means, corner + hammersley(32) / 64, atol=1e-6)
    assert torch.allclose(found.log_scales.exp(), torch.tensor(math.hypot(4e-3, 9e-4)))
    assert torch.allclose(found.logit_opacities.sigmoid(), torch.tensor(0.1))
    assert torch.equal(found.quats, torch.tensor([1.0, 0, 0, 0]).expand(32, 4))


def test_without_perturbation_all_gaussians_of_raw_zero_sit_at_the_centre() -> None:
    config = RepresentationConfig(perturb_offset=False, num_gaussians=4)
    found = raw_to_gaussians(
        torch.zeros(1, 56), torch.tensor([[1, 0, 3]]), offset_perturbation(config), config, 4
    )
    assert torch.allclose(found.means, torch.tensor([-0.125, -0.375, 0.375]).expand(4, 3))


def test_half_precision_raw_is_computed_in_float32() -> None:
    config = RepresentationConfig(num_gaussians=2)
    raw = torch.randn(3, 28, generator=torch.Generator().manual_seed(0)).half()
    coords = torch.tensor([[0, 1, 2], [60, 61, 62], [63, 63, 63]])
    half = raw_to_gaussians(raw, coords, offset_perturbation(config), config, 64)
    full = raw_to_gaussians(raw.float(), coords, offset_perturbation(config), config, 64)
    assert half.means.dtype == torch.float32
    assert torch.equal(half.means, full.means)


def test_gradients_reach_every_raw_channel() -> None:
    config = RepresentationConfig(num_gaussians=3)
    raw = torch.randn(4, 42, generator=torch.Generator().manual_seed(1)).requires_grad_()
    found = raw_to_gaussians(
        raw, torch.zeros(4, 3, dtype=torch.int32), offset_perturbation(config), config, 8
    )
    weights = torch.Generator().manual_seed(2)
    sum(
        (getattr(found, name) * torch.randn(getattr(found, name).shape, generator=weights)).sum()
        for name in ("means", "quats", "log_scales", "logit_opacities", "sh")
    ).backward()  # type: ignore[union-attr]
    assert raw.grad is not None
    assert bool((raw.grad != 0).all())


def test_no_voxels_give_no_gaussians() -> None:
    found = raw_to_gaussians(
        torch.zeros(0, 448), torch.zeros(0, 3), offset_perturbation(PUBLISHED), PUBLISHED, 64
    )
    found.validate()
    assert len(found) == 0
    assert found.sh.shape == (0, 1, 3)


def test_published_names_round_trip_and_unknown_ones_are_refused() -> None:
    published = golden_config("slat_dec_gs")["args"]["representation_config"]
    config = RepresentationConfig.model_validate(published)
    assert config.num_gaussians == 8
    assert config.model_dump(by_alias=True, exclude_unset=True) == published
    whole = PUBLISHED.model_dump(by_alias=True, exclude={"base_color"})
    assert whole == {**published, "num_gaussians": 32}
    for wrong in ({"3d_filter": 1.0}, {"voxel_size": 1.0}, {"opacity_bias": 1.0}):
        with pytest.raises(ValidationError):
            RepresentationConfig.model_validate({**published, **wrong})
