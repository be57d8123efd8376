"""Normalisations of the TRELLIS networks; all compute in float32 and keep the input's dtype."""

from __future__ import annotations

import math

import torch
from torch import Tensor, nn
from torch.nn import functional


class LayerNorm32(nn.LayerNorm):
    """Layer normalisation over the last axis, computed in float32.

    Its weights stay float32 in a half-precision torso. Without `affine` it has no parameters, so
    no names in a checkpoint.

    Args:
        channels: length of the last axis.
        affine: learn a weight and a bias.
        eps: added to the variance; 1e-6 in transformer and sparse residual blocks.
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

    Args:
        head_channels: D.
        heads: H; `gamma` is (H, D), float32 in every torso.
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
