"""Transformer blocks: time-modulated with cross-attention, and the plain one of the VAEs."""

from __future__ import annotations

import torch
from torch import Tensor, nn

from recast.trellis.layers.attention import CrossAttention, SelfAttention
from recast.trellis.layers.layout import TokenLayout
from recast.trellis.layers.norm import LayerNorm32


def modulation_layer(channels: int) -> nn.Sequential:
    """Time embedding (B, C) to the six modulation vectors (B, 6 C) of adaptive layer norm."""
    return nn.Sequential(nn.SiLU(), nn.Linear(channels, 6 * channels))


class FeedForward(nn.Module):
    """Linear, GELU in its tanh approximation, Linear.

    Args:
        channels: C of the tokens.
        ratio: hidden channels over C.
    """

    def __init__(self, channels: int, ratio: float = 4.0) -> None:
        super().__init__()
        hidden = int(channels * ratio)
        # Published checkpoints name these `mlp.mlp.0` and `mlp.mlp.2` under a block's `mlp`.
        self.mlp = nn.Sequential(
            nn.Linear(channels, hidden), nn.GELU(approximate="tanh"), nn.Linear(hidden, channels)
        )

    def forward(self, h: Tensor) -> Tensor:
        """Tokens (..., C) to tokens (..., C)."""
        out: Tensor = self.mlp(h)
        return out


class ModulatedCrossBlock(nn.Module):
    """Block of both flow transformers: self-attention, cross-attention to the image, MLP.

    Self-attention and MLP are shifted, scaled and gated by the time (adaptive layer norm, Peebles
    and Xie 2023); cross-attention has an affine norm and no gate.

    Args:
        channels: C of the tokens.
        context_channels: channels of the context.
        heads: attention heads.
        mlp_ratio: hidden channels of the MLP over C.
        qk_rms_norm: normalise queries and keys of the self-attention.
        qk_rms_norm_cross: the same in the cross-attention.
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
        self.mlp = FeedForward(channels, mlp_ratio)
        self.adaLN_modulation = None if share_mod else modulation_layer(channels)

    def initialise(self, generator: torch.Generator | None = None) -> None:
        """Start the modulation at zero, so that only the cross-attention acts; draws nothing."""
        if self.adaLN_modulation is not None:
            for parameter in self.adaLN_modulation.parameters():
                nn.init.zeros_(parameter)

    def forward(self, h: Tensor, modulation: Tensor, cond: Tensor, layout: TokenLayout) -> Tensor:
        """One block.

        Args:
            h: (..., C) tokens.
            modulation: (B, C) time embedding, or with `share_mod` the modulation (B, 6 C).
            cond: (B, L, context_channels) context of each sample.
            layout: which tokens belong together.

        Returns:
            (..., C) tokens.
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

    Args:
        channels: C of the tokens.
        heads: attention heads.
        mlp_ratio: hidden channels of the MLP over C.
        qk_rms_norm: normalise queries and keys.
    """

    def __init__(
        self, channels: int, heads: int, mlp_ratio: float = 4.0, qk_rms_norm: bool = False
    ) -> None:
        super().__init__()
        self.norm1 = LayerNorm32(channels, affine=False)
        self.norm2 = LayerNorm32(channels, affine=False)
        self.attn = SelfAttention(channels, heads, qk_rms_norm)
        self.mlp = FeedForward(channels, mlp_ratio)

    def forward(self, h: Tensor, layout: TokenLayout) -> Tensor:
        """Tokens (..., C) to tokens (..., C)."""
        h = h + self.attn(self.norm1(h), layout)
        out: Tensor = h + self.mlp(self.norm2(h))
        return out
