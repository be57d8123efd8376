"""Multi-head self- and cross-attention over any token layout, and the normalisations around it."""

from __future__ import annotations

import math
from typing import Protocol

import torch
from torch import Tensor, nn
from torch.nn import functional

from recast.trellis.sparse import attention


class TokenLayout(Protocol):
    """How tokens (..., C) fall into samples, and which of them attend to which.

    The layers know nothing else about their tokens, so one set of modules serves the dense tokens
    of the sparse structure, (B, N, C), and the packed or windowed tokens of voxels, (T, C).
    """

    def spread(self, per_sample: Tensor) -> Tensor:
        """Values (B, C) of the samples in a shape that broadcasts against the tokens."""
        ...

    def attend(self, q: Tensor, k: Tensor, v: Tensor) -> Tensor:
        """Self-attention, all of them (..., H, D): softmax(q k^T / sqrt(D)) v within a group."""
        ...

    def attend_to(self, q: Tensor, k: Tensor, v: Tensor) -> Tensor:
        """Attention of queries (..., H, D) to their sample's context: k, v (B, L, H, D)."""
        ...


class DenseTokens:
    """Tokens (B, N, C): every token of a sample attends to all tokens of that sample."""

    def spread(self, per_sample: Tensor) -> Tensor:
        """(B, C) to (B, 1, C)."""
        return per_sample.unsqueeze(1)

    def attend(self, q: Tensor, k: Tensor, v: Tensor) -> Tensor:
        """Attention of (B, N, H, D) to all tokens (B, L, H, D) of the sample."""
        return attention(q, k, v)

    attend_to = attend


class LayerNorm32(nn.LayerNorm):
    """Layer normalisation over the last axis, computed in float32.

    Its weights stay float32 in a half-precision torso. Without `affine` it has no parameters, so
    no names in a checkpoint.

    Args:
        channels: length of the last axis.
        affine: learn a weight and a bias.
        eps: number added to the variance; 1e-6 in transformer and sparse residual blocks.
    """

    def __init__(self, channels: int, affine: bool, eps: float = 1e-6) -> None:
        super().__init__(channels, eps=eps, elementwise_affine=affine)

    def forward(self, x: Tensor) -> Tensor:
        """Tensor (..., channels) to the same shape and dtype."""
        return super().forward(x.float()).to(x.dtype)


class ChannelLayerNorm32(LayerNorm32):
    """Layer normalisation over the channels of each voxel of a dense grid, with affine weights.

    Its epsilon is 1e-5, unlike that of the transformer blocks.
    """

    def __init__(self, channels: int) -> None:
        super().__init__(channels, affine=True, eps=1e-5)

    def forward(self, x: Tensor) -> Tensor:
        """Grid (B, channels, X, Y, Z) to the same shape and dtype, channels last in memory."""
        return super().forward(x.movedim(1, -1)).movedim(-1, 1)


class MultiHeadRmsNorm(nn.Module):
    """Per-head normalisation of queries or keys: x / max(|x|, 1e-12) * gamma * sqrt(D).

    An L2 normalisation rather than the usual RMS norm: there is no epsilon inside the mean.
    `gamma` is (H, D), heads by channels of a head, float32 in every torso.
    """

    def __init__(self, head_channels: int, heads: int) -> None:
        super().__init__()
        self.scale = math.sqrt(head_channels)
        self.gamma = nn.Parameter(torch.ones(heads, head_channels))

    def forward(self, x: Tensor) -> Tensor:
        """Tensor (..., H, D) to the same shape and dtype."""
        return (functional.normalize(x.float(), dim=-1) * self.gamma * self.scale).to(x.dtype)


def final_norm(h: Tensor) -> Tensor:
    """Normalisation before an output layer: over the last axis, no affine, eps 1e-5.

    Runs in the dtype it is given; the caller decides whether to leave half precision before.
    """
    return functional.layer_norm(h, h.shape[-1:])


class _HeadNorms(nn.Module):
    """Heads of self- and cross-attention, and their optional normalisation."""

    def __init__(self, channels: int, heads: int, qk_rms_norm: bool) -> None:
        super().__init__()
        if channels % heads:
            raise ValueError(f"{channels} channels do not divide into {heads} heads")
        self.heads = heads
        self.qk_rms_norm = qk_rms_norm
        if qk_rms_norm:
            self.q_rms_norm = MultiHeadRmsNorm(channels // heads, heads)
            self.k_rms_norm = MultiHeadRmsNorm(channels // heads, heads)

    def split(self, projected: Tensor, parts: int) -> tuple[Tensor, ...]:
        """(..., parts * C) to `parts` tensors (..., H, D)."""
        return projected.unflatten(-1, (parts, self.heads, -1)).unbind(-3)

    def normalised(self, q: Tensor, k: Tensor) -> tuple[Tensor, Tensor]:
        """Queries and keys as attention takes them."""
        return (self.q_rms_norm(q), self.k_rms_norm(k)) if self.qk_rms_norm else (q, k)


class SelfAttention(_HeadNorms):
    """Attention of the tokens to one another, in the groups that their layout defines.

    Args:
        channels: C of the tokens.
        heads: H; C must be a multiple of it.
        qk_rms_norm: normalise queries and keys per head.

    Raises:
        ValueError: the channels do not divide into the heads.
    """

    def __init__(self, channels: int, heads: int, qk_rms_norm: bool = False) -> None:
        super().__init__(channels, heads, qk_rms_norm)
        self.to_qkv = nn.Linear(channels, 3 * channels)
        self.to_out = nn.Linear(channels, channels)

    def forward(self, h: Tensor, layout: TokenLayout) -> Tensor:
        """Tokens (..., C) to tokens (..., C)."""
        q, k, v = self.split(self.to_qkv(h), 3)
        q, k = self.normalised(q, k)
        return self.to_out(layout.attend(q, k, v).flatten(-2))


class CrossAttention(_HeadNorms):
    """Attention of the tokens to the context of their sample, such as image tokens.

    Args:
        channels, heads, qk_rms_norm: see `SelfAttention`.
        context_channels: channels of the context.

    Raises:
        ValueError: the channels do not divide into the heads.
    """

    def __init__(
        self, channels: int, context_channels: int, heads: int, qk_rms_norm: bool = False
    ) -> None:
        super().__init__(channels, heads, qk_rms_norm)
        self.to_q = nn.Linear(channels, channels)
        self.to_kv = nn.Linear(context_channels, 2 * channels)
        self.to_out = nn.Linear(channels, channels)

    def forward(self, h: Tensor, context: Tensor, layout: TokenLayout) -> Tensor:
        """Tokens (..., C) and context (B, L, context_channels) to tokens (..., C)."""
        (q,) = self.split(self.to_q(h), 1)
        k, v = self.split(self.to_kv(context), 2)
        q, k = self.normalised(q, k)
        return self.to_out(layout.attend_to(q, k, v).flatten(-2))
