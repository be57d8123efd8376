from __future__ import annotations

import pytest
import torch
from torch import Tensor

from recast.trellis.layers import (
    CrossAttention,
    DenseTokens,
    ModulatedCrossBlock,
    SelfAttention,
    TransformerBlock,
)
from support.trellis import assert_same, golden_tensors


class Segments:
    """Packed tokens (T, C) whose samples are given by their lengths, in the plainest form."""

    def __init__(self, counts: list[int]) -> None:
        self.counts = counts

    def spread(self, per_sample: Tensor) -> Tensor:
        return per_sample.repeat_interleave(torch.tensor(self.counts), dim=0)

    def attend(self, q: Tensor, k: Tensor, v: Tensor) -> Tensor:
        parts = zip(*(x.split(self.counts) for x in (q, k, v)), strict=True)
        return torch.cat([softmax_attention(*part) for part in parts])

    def attend_to(self, q: Tensor, k: Tensor, v: Tensor) -> Tensor:
        parts = zip(q.split(self.counts), k, v, strict=True)
        return torch.cat([softmax_attention(*part) for part in parts])


def softmax_attention(q: Tensor, k: Tensor, v: Tensor) -> Tensor:
    """(N, H, D), (L, H, D), (L, H, D) to (N, H, D)."""
    scores = torch.einsum("nhd,lhd->hnl", q, k) / q.shape[-1] ** 0.5
    return torch.einsum("hnl,lhd->nhd", scores.softmax(dim=-1), v)


def values(*shape: int, seed: int = 0) -> Tensor:
    return torch.randn(shape, generator=torch.Generator().manual_seed(seed))


def randomised(module: torch.nn.Module) -> torch.nn.Module:
    generator = torch.Generator().manual_seed(9)
    with torch.no_grad():
        for parameter in module.parameters():
            parameter.add_(0.2 * torch.randn(parameter.shape, generator=generator))
    return module


@pytest.mark.parametrize("norm", [False, True])
@torch.no_grad()
def test_dense_self_attention_is_softmax_attention(norm: bool) -> None:
    attention = randomised(SelfAttention(24, 3, qk_rms_norm=norm))
    h = values(2, 10, 24)
    packed = attention(h.flatten(0, 1), Segments([10, 10]))
    assert_same(attention(h, DenseTokens()).flatten(0, 1), packed)


@torch.no_grad()
def test_query_key_value_come_in_that_order() -> None:
    attention = randomised(SelfAttention(8, 2))
    h = values(1, 6, 8)
    q, k, v = attention.to_qkv(h)[0].split(8, dim=1)  # type: ignore[operator]
    heads = [x.reshape(6, 2, 4) for x in (q, k, v)]
    expected = attention.to_out(softmax_attention(*heads).flatten(1))  # type: ignore[operator]
    assert_same(attention(h, DenseTokens())[0], expected)


@pytest.mark.parametrize("norm", [False, True])
@torch.no_grad()
def test_cross_attention_sees_the_context_of_its_own_sample(norm: bool) -> None:
    attention = randomised(CrossAttention(24, 5, 3, qk_rms_norm=norm))
    h, context = values(2, 7, 24), values(2, 4, 5, seed=1)
    packed = attention(h.flatten(0, 1), context, Segments([7, 7]))
    together = attention(h, context, DenseTokens())
    assert_same(together.flatten(0, 1), packed)
    other = context.clone()
    other[1] += 1
    changed = attention(h, other, DenseTokens())
    assert torch.equal(changed[0], together[0])
    assert not torch.allclose(changed[1], together[1])


@pytest.mark.parametrize("share", [False, True])
@torch.no_grad()
def test_one_block_serves_dense_and_packed_tokens(share: bool) -> None:
    block = randomised(ModulatedCrossBlock(24, 5, 3, qk_rms_norm=True, share_mod=share))
    h, context, modulation = values(2, 7, 24), values(2, 4, 5, seed=1), values(2, 24, seed=2)
    if share:
        modulation = modulation.repeat(1, 6)
    packed = block(h.flatten(0, 1), modulation, context, Segments([7, 7]))
    assert_same(block(h, modulation, context, DenseTokens()).flatten(0, 1), packed)


@torch.no_grad()
def test_a_new_modulated_block_passes_tokens_on_but_for_its_context() -> None:
    block = ModulatedCrossBlock(8, 5, 2)
    block.initialise()
    h, context = values(1, 3, 8), values(1, 4, 5)
    expected = h + block.cross_attn(block.norm2(h), context, DenseTokens())
    assert torch.equal(block(h, values(1, 8), context, DenseTokens()), expected)


@torch.no_grad()
def test_vae_block_takes_the_published_names_and_adds_attention_and_mlp() -> None:
    weights = golden_tensors("slat_enc")
    prefix = "blocks.0."
    block = TransformerBlock(64, 4)
    block.load_state_dict(
        {k.removeprefix(prefix): v for k, v in weights.items() if k.startswith(prefix)}
    )
    h = values(1, 9, 64)
    middle = h + block.attn(torch.nn.functional.layer_norm(h, (64,), eps=1e-6), DenseTokens())
    up, down = block.mlp.mlp[0], block.mlp.mlp[2]
    hidden = up(torch.nn.functional.layer_norm(middle, (64,), eps=1e-6))
    bent = hidden / 2 * (1 + torch.tanh((2 / torch.pi) ** 0.5 * (hidden + 0.044715 * hidden**3)))
    assert_same(block(h, DenseTokens()), middle + down(bent))


def test_channels_that_do_not_divide_into_heads_are_refused() -> None:
    with pytest.raises(ValueError, match="10 channels do not divide into 4 heads"):
        SelfAttention(10, 4)
