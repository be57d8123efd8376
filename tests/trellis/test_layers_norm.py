from __future__ import annotations

import pytest
import torch

from recast.trellis.layers import ChannelLayerNorm32, LayerNorm32, MultiHeadRmsNorm, final_norm


def values(*shape: int) -> torch.Tensor:
    return torch.randn(shape, generator=torch.Generator().manual_seed(5))


@torch.no_grad()
def test_layer_norm_has_the_epsilon_it_is_given() -> None:
    x = 1e-3 * values(7, 16)  # a variance near the epsilons
    centred = x - x.mean(dim=1, keepdim=True)
    variance = x.var(dim=1, correction=0, keepdim=True)
    assert torch.allclose(LayerNorm32(16, affine=False)(x), centred / (variance + 1e-6).sqrt())
    assert torch.allclose(final_norm(x), centred / (variance + 1e-5).sqrt())


@torch.no_grad()
def test_layer_norm_computes_in_float32() -> None:
    x = (values(3, 8) * 200).half()  # squares overflow half precision
    norm = LayerNorm32(8, affine=True)
    assert norm(x).dtype == torch.float16
    assert torch.equal(norm(x), norm(x.float()).half())
    assert set(norm.state_dict()) == {"weight", "bias"}
    assert not LayerNorm32(8, affine=False).state_dict()


@torch.no_grad()
def test_channel_norm_normalises_each_voxel() -> None:
    x = 1e-2 * values(2, 6, 3, 4, 5)
    norm = ChannelLayerNorm32(6)
    norm.weight.copy_(values(6))
    norm.bias.copy_(values(6) + 1)
    centred = x - x.mean(dim=1, keepdim=True)
    scaled = centred / (x.var(dim=1, correction=0, keepdim=True) + 1e-5).sqrt()
    expected = scaled * norm.weight.view(-1, 1, 1, 1) + norm.bias.view(-1, 1, 1, 1)
    found = norm(x)
    assert found.is_contiguous(memory_format=torch.channels_last_3d)
    assert torch.allclose(found, expected, atol=1e-6)


@torch.no_grad()
def test_rms_norm_is_a_scaled_unit_vector_per_head() -> None:
    x = 1e-4 * values(5, 4, 16)  # an epsilon in the mean would show
    norm = MultiHeadRmsNorm(16, 4)
    norm.gamma.copy_(1 + 0.1 * values(4, 16))
    unit = x / x.square().sum(dim=-1, keepdim=True).sqrt()
    assert torch.allclose(norm(x), unit * norm.gamma * 4.0, rtol=1e-5)
    assert norm(x.half()).dtype == torch.float16


def test_rms_norm_of_zero_is_zero() -> None:
    out = MultiHeadRmsNorm(8, 2)(torch.zeros(3, 2, 8))
    assert float(out.detach().abs().max()) == pytest.approx(0.0)
