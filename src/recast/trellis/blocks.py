"""Blocks of the TRELLIS networks, plain or modulated by the time's embedding; and embeddings."""

from __future__ import annotations

import math
from collections import OrderedDict

import torch
from torch import Tensor, nn
from torch.nn import functional
from torch.nn.functional import silu

from recast.trellis.attention import CrossAttention, LayerNorm32, SelfAttention, TokenLayout
from recast.trellis.sparse import PackedTokens, PoolIndex, SparseTensor, SubMConv3d, unpool

MAX_PERIOD = 10000.0
_FREQUENCIES = 256  # channels of a time's sines and cosines


def start_at_zero(layer: nn.Module) -> None:
    """Zero the parameters of an output, modulation or last convolution layer."""
    for parameter in layer.parameters():
        nn.init.zeros_(parameter)


def modulation_layer(channels: int) -> nn.Sequential:
    """Time embedding (B, C) to the six modulation vectors (B, 6 C) of adaptive layer norm."""
    return nn.Sequential(nn.SiLU(), nn.Linear(channels, 6 * channels))


def feed_forward(channels: int, ratio: float) -> nn.Sequential:
    """Linear, GELU in its tanh approximation, Linear; `ratio` is hidden channels over channels."""
    hidden = int(channels * ratio)
    layers = nn.Sequential(
        nn.Linear(channels, hidden), nn.GELU(approximate="tanh"), nn.Linear(hidden, channels)
    )
    # Published checkpoints name these `mlp.mlp.0` and `mlp.mlp.2` under a block's `mlp`.
    return nn.Sequential(OrderedDict(mlp=layers))


class ModulatedCrossBlock(nn.Module):
    """Block of both flow transformers: self-attention, cross-attention to the image, MLP.

    Self-attention and MLP are shifted, scaled and gated by the time (adaptive layer norm, Peebles
    and Xie 2023); cross-attention has an affine norm and no gate.

    Args:
        channels, context_channels: C of the tokens, and channels of the context.
        heads: attention heads; C must be a multiple of it.
        mlp_ratio: hidden channels of the MLP over C.
        qk_rms_norm, qk_rms_norm_cross: normalise queries and keys of the self-attention, and of the
            cross-attention.
        share_mod: the model computes the modulation once for all blocks; this block then has no
            modulation layer of its own.
    """

    def __init__(
        self,
        channels: int,
        context_channels: int,
        heads: int,
        mlp_ratio: float = 4.0,
        *,
        qk_rms_norm: bool = False,
        qk_rms_norm_cross: bool = False,
        share_mod: bool = False,
    ) -> None:
        super().__init__()
        self.norm1 = LayerNorm32(channels, affine=False)
        self.norm2 = LayerNorm32(channels, affine=True)
        self.norm3 = LayerNorm32(channels, affine=False)
        self.self_attn = SelfAttention(channels, heads, qk_rms_norm)
        self.cross_attn = CrossAttention(channels, context_channels, heads, qk_rms_norm_cross)
        self.mlp = feed_forward(channels, mlp_ratio)
        self.adaLN_modulation = None if share_mod else modulation_layer(channels)

    def initialise(self, generator: torch.Generator | None = None) -> None:
        """Start the modulation at zero, so that only the cross-attention acts; draws nothing."""
        if self.adaLN_modulation is not None:
            start_at_zero(self.adaLN_modulation)

    def forward(self, h: Tensor, modulation: Tensor, cond: Tensor, layout: TokenLayout) -> Tensor:
        """Tokens (..., C) to tokens (..., C).

        Args:
            modulation: (B, C) time embedding, or with `share_mod` the modulation (B, 6 C).
            cond: (B, L, context_channels) context of each sample.
            layout: which tokens belong together.
        """
        if self.adaLN_modulation is not None:
            modulation = self.adaLN_modulation(modulation)
        parts = (layout.spread(part) for part in modulation.chunk(6, dim=1))
        shift_attn, scale_attn, gate_attn, shift_mlp, scale_mlp, gate_mlp = parts
        modulated = self.norm1(h) * (1 + scale_attn) + shift_attn
        h = h + gate_attn * self.self_attn(modulated, layout)
        h = h + self.cross_attn(self.norm2(h), cond, layout)
        modulated = self.norm3(h) * (1 + scale_mlp) + shift_mlp
        return h + gate_mlp * self.mlp(modulated)


class TransformerBlock(nn.Module):
    """Pre-norm block of the structured-latent VAE; its norms have no parameters.

    Arguments are those of `ModulatedCrossBlock`.
    """

    def __init__(
        self, channels: int, heads: int, mlp_ratio: float = 4.0, qk_rms_norm: bool = False
    ) -> None:
        super().__init__()
        self.norm1 = LayerNorm32(channels, affine=False)
        self.norm2 = LayerNorm32(channels, affine=False)
        self.attn = SelfAttention(channels, heads, qk_rms_norm)
        self.mlp = feed_forward(channels, mlp_ratio)

    def forward(self, h: Tensor, layout: TokenLayout) -> Tensor:
        """Tokens (..., C) to tokens (..., C)."""
        h = h + self.attn(self.norm1(h), layout)
        return h + self.mlp(self.norm2(h))


def timestep_embedding(t: Tensor, channels: int) -> Tensor:
    """Cosines, then sines, of times (B,) at geometrically spaced frequencies: (B, channels).

    In float32. Times are multiplied by 1000 already, fractions are fine; `channels` is even
    (Peebles and Xie 2023, DiT).
    """
    half = channels // 2
    # In float32 an angle of 1000 is only good to 6e-5, and its cosine differs between processors.
    steps = torch.arange(half, dtype=torch.float64, device=t.device)
    angles = t.double().unsqueeze(1) * torch.exp(-math.log(MAX_PERIOD) * steps / half)
    return torch.cat([angles.cos(), angles.sin()], dim=1).float()


def absolute_positions(coords: Tensor, channels: int) -> Tensor:
    """Sinusoidal embedding (T, channels) float32 of voxel indices (T, 3), x, y, z, not scaled.

    With f = channels // 3 // 2 frequencies 10000^(-i/f), each axis gives [sin(p w), cos(p w)]; the
    axes follow one another and zeros fill up to `channels`.
    """
    count = channels // 3 // 2
    steps = torch.arange(count, dtype=torch.float64, device=coords.device) / count
    angles = coords.double().unsqueeze(-1) * MAX_PERIOD**-steps
    embedding = torch.cat([angles.sin(), angles.cos()], dim=-1).flatten(1).float()
    return functional.pad(embedding, (0, channels - embedding.shape[1]))


class TimestepEmbedder(nn.Module):
    """Diffusion times to a conditioning vector: sinusoids, Linear, SiLU, Linear, all in float32."""

    def __init__(self, channels: int) -> None:
        super().__init__()
        self.mlp = nn.Sequential(
            nn.Linear(_FREQUENCIES, channels), nn.SiLU(), nn.Linear(channels, channels)
        )

    def initialise(self, generator: torch.Generator | None = None) -> None:
        """Draw both weights from N(0, 0.02), without touching the biases."""
        for layer in self.mlp:
            if isinstance(layer, nn.Linear):
                nn.init.normal_(layer.weight, std=0.02, generator=generator)

    def forward(self, t: Tensor) -> Tensor:
        """Times (B,), already multiplied by 1000, to (B, channels)."""
        return self.mlp(timestep_embedding(t, _FREQUENCIES))


class SparseResBlock3d(nn.Module):
    """Two 3x3x3 submanifold convolutions around a scale and shift by the time.

        h = conv1(silu(norm1(x)));  h = norm2(h) * (1 + scale) + shift
        out = conv2(silu(h)) + skip(x)

    The linear layer of the time embedding gives scale first, then shift: the reverse of the
    transformer blocks' order.

    The skip connection is linear where input and output channels differ; `emb_channels` are those
    of the time embedding.
    """

    def __init__(self, in_channels: int, emb_channels: int, out_channels: int) -> None:
        super().__init__()
        self.norm1 = LayerNorm32(in_channels, affine=True)
        self.norm2 = LayerNorm32(out_channels, affine=False)
        self.conv1 = SubMConv3d(in_channels, out_channels)
        self.conv2 = SubMConv3d(out_channels, out_channels)
        self.emb_layers = nn.Sequential(nn.SiLU(), nn.Linear(emb_channels, 2 * out_channels))
        self.skip_connection: nn.Module = (
            nn.Linear(in_channels, out_channels) if in_channels != out_channels else nn.Identity()
        )

    def forward(
        self, x: SparseTensor, t_emb: Tensor, index: PoolIndex | None = None
    ) -> SparseTensor:
        """One block.

        Args:
            x: (T, in_channels) voxels.
            t_emb: (B, emb_channels) time embedding of each sample.
            index: makes this an upsampling block: `x` lives on the pooled voxels and is taken to
                those that `index` was made from. The norm and the skip connection treat every row
                alone and unpooling copies rows, so they run before it, on few rows, to the same
                effect.

        Returns:
            (T, out_channels) voxels, on the fine grid where `index` is given.
        """
        skip = x.with_feats(self.skip_connection(x.feats))
        h = x.with_feats(silu(self.norm1(x.feats)))
        if index is not None:
            h, skip = unpool(h, index), unpool(skip, index)
        h = self.conv1(h)
        layout = PackedTokens(h)
        scale, shift = (layout.spread(part) for part in self.emb_layers(t_emb).chunk(2, dim=1))
        h = self.conv2(h.with_feats(silu(self.norm2(h.feats) * (1 + scale) + shift)))
        return h.with_feats(h.feats + skip.feats)
