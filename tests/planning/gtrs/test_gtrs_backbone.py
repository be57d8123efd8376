"""The backbone: released names and sizes, reference features, and small ones of the family."""

from __future__ import annotations

import math
import zlib

import numpy as np
import pytest
import torch
from safetensors.torch import load_file
from torch import Tensor

from recast.planning.gtrs import (
    HEADS,
    BackboneConfig,
    BackboneStage,
    GtrsConfig,
    GtrsModel,
    empty_model,
    final_score,
    new_model,
)
from recast.planning.gtrs.model import VovNet
from recast.planning.gtrs.planner import UNUSED, VOCABULARY
from support.tiny_gtrs import GOLDEN, TINY


def test_names_and_shapes_are_the_released_ones(
    released_keys: dict[str, tuple[int, ...]],
) -> None:
    model = {k: tuple(v.shape) for k, v in empty_model(GtrsConfig()).state_dict().items()}
    unused = {k: v for k, v in released_keys.items() if k.startswith(UNUSED)}
    assert len(released_keys) == 797
    assert model | unused | {VOCABULARY: (16384, 40, 3)} == released_keys
    assert not model.keys() & unused.keys()


@pytest.mark.parametrize("frozen", [True, False])
def test_norms_folded_into_convolutions_change_nothing(frozen: bool) -> None:
    config = TINY.backbone.model_copy(update={"frozen_norm": frozen})
    backbone, rng = VovNet(config).eval(), torch.Generator().manual_seed(0)
    for module in backbone.modules():
        if isinstance(module, torch.nn.BatchNorm2d):
            for tensor in (module.weight.data, module.running_var):
                tensor.uniform_(0.5, 2.0, generator=rng)
            for tensor in (module.bias.data, module.running_mean):
                tensor.uniform_(-0.5, 0.5, generator=rng)
    images = torch.rand(2, 3, 64, 96, generator=rng)
    before = images.clone()
    unfolded = backbone(images).detach()  # with gradients nothing is folded
    with torch.no_grad():
        folded = backbone(images)
        backbone.stem[1].weight.data.mul_(1.5)  # weights may change at any time
        changed = backbone(images)
    assert unfolded.abs().max() > 0.1
    torch.testing.assert_close(folded, unfolded, rtol=1e-5, atol=1e-5)
    torch.testing.assert_close(changed, backbone(images).detach(), rtol=1e-5, atol=1e-5)
    assert not torch.equal(changed, folded) and torch.equal(images, before)


def test_in_training_the_batch_is_normalised_without_gradients_too() -> None:
    backbone = VovNet(TINY.backbone.model_copy(update={"frozen_norm": False})).train()
    norm = backbone.stem[1]
    with torch.no_grad():
        backbone(torch.rand(2, 3, 32, 32))
    assert isinstance(norm, torch.nn.BatchNorm2d) and norm.num_batches_tracked == 1


def _procedural(name: str, shape: tuple[int, ...]) -> np.ndarray:
    """Weights that a name and a shape determine, as the reference vectors were made."""
    r = np.random.RandomState(zlib.crc32(name.encode()))
    if name.endswith("running_mean"):
        return 0.05 * r.standard_normal(shape)
    if name.endswith("running_var"):
        return 1 + 0.2 * r.random_sample(shape)
    if any(f"{norm}.weight" in name for norm in ("/norm", ".norm1", ".norm2", ".norm3")):
        return 1 + 0.1 * r.standard_normal(shape)
    if len(shape) >= 2:
        gain = 1.6 if len(shape) == 4 else 1.0
        return r.standard_normal(shape) * math.sqrt(gain / math.prod(shape[1:]))
    return 0.05 * r.standard_normal(shape)


@pytest.fixture(scope="module")
def full_width() -> GtrsModel:
    """All widths of the released model, with 2 x 8 image tokens."""
    model = empty_model(GtrsConfig(token_rows=2, token_columns=8)).to_empty(device="cpu")
    with torch.no_grad():
        for name, tensor in model.state_dict().items():
            if tensor.is_floating_point():
                tensor.copy_(torch.from_numpy(_procedural(name, tuple(tensor.shape))))
    return model.eval()


@pytest.fixture(scope="module")
def expected() -> dict[str, Tensor]:
    return load_file(GOLDEN / "gtrs_fullwidth_procedural.safetensors")


@torch.no_grad()
def test_full_width_against_reference(
    full_width: GtrsModel, expected: dict[str, Tensor], released_vocabulary: Tensor
) -> None:
    pixels = np.random.RandomState(42).random_sample((2, 3, 64, 256))
    stages = full_width.backbone.stages(torch.from_numpy(pixels.astype(np.float32)))
    torch.testing.assert_close(stages[2][:, ::16], expected["mid.stage4_s"], rtol=1e-4, atol=1e-4)
    torch.testing.assert_close(stages[3], expected["mid.stage5"], rtol=1e-4, atol=1e-4)
    logits = full_width.score(
        full_width.look(stages[3]), expected["in.status"], released_vocabulary[::32]
    )
    for name in HEADS:
        torch.testing.assert_close(logits[name], expected[f"logit.{name}"], rtol=1e-4, atol=1e-4)
    scores = final_score(logits)
    torch.testing.assert_close(scores, expected["scores"], rtol=1e-4, atol=1e-4)
    assert scores.argmax(1).tolist() == expected["selected_indices"].tolist()


@torch.no_grad()
def test_pools_round_up_and_strides_are_those_of_the_configuration() -> None:
    backbone = new_model(TINY, torch.Generator().manual_seed(0)).backbone
    stages = backbone.stages(torch.rand(1, 3, 36, 60, generator=torch.Generator().manual_seed(1)))
    assert [tuple(s.shape[1:]) for s in stages] == [(16, 9, 15), (24, 4, 7)]
    assert TINY.backbone.stride == 8


@torch.no_grad()
def test_channel_attention_follows_its_formula() -> None:
    block = new_model(TINY, torch.Generator().manual_seed(0)).backbone.stage2.OSA2_1
    y = torch.randn(2, 16, 3, 5, generator=torch.Generator().manual_seed(1))
    mean = block.ese.fc(torch.nn.functional.adaptive_avg_pool2d(y, 1))
    expected = y * torch.nn.functional.relu6(mean + 3) / 6
    torch.testing.assert_close(block.ese(y), expected)


@pytest.mark.parametrize("frozen", [True, False])
def test_batch_norm_in_training(frozen: bool) -> None:
    stage = BackboneStage(blocks=2, conv_channels=4, out_channels=8)
    backbone = VovNet(BackboneConfig(stem=(4, 4, 4), stages=(stage,), frozen_norm=frozen)).train()
    before = {k: v.clone() for k, v in backbone.state_dict().items() if "running" in k}
    images = torch.rand(2, 3, 16, 16, generator=torch.Generator().manual_seed(0))
    backbone(images).sum().backward()
    after = backbone.state_dict()
    assert all(torch.equal(before[k], after[k]) for k in before) == frozen
    assert all(p.grad is not None for p in backbone.parameters())


def test_the_same_seed_gives_the_same_model() -> None:
    torch.manual_seed(7)
    first = new_model(TINY, torch.Generator().manual_seed(4)).state_dict()
    again = new_model(TINY, torch.Generator().manual_seed(4)).state_dict()
    other = new_model(TINY, torch.Generator().manual_seed(5)).state_dict()
    assert all(torch.equal(first[k], again[k]) for k in first)
    assert not torch.equal(first["downscale_layer.weight"], other["downscale_layer.weight"])
    assert all(torch.isfinite(value).all() for value in first.values())


@pytest.mark.slow
@torch.no_grad()
def test_the_released_size_runs() -> None:
    model = new_model(GtrsConfig(), torch.Generator().manual_seed(0))
    generator = torch.Generator().manual_seed(1)
    vocabulary = torch.rand(8192, 40, 3, generator=generator)
    logits = model(torch.rand(1, 3, 512, 2048, generator=generator), torch.zeros(1, 8), vocabulary)
    assert final_score(logits).shape == (1, 8192)
    assert torch.isfinite(final_score(logits)).all()
