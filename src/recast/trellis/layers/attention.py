"""Multi-head self- and cross-attention over any token layout."""

from __future__ import annotations

from torch import Tensor, nn

from recast.trellis.layers.layout import TokenLayout
from recast.trellis.layers.norm import MultiHeadRmsNorm


class _HeadNorms(nn.Module):
    """The optional normalisation of queries and keys that both kinds of attention share."""

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
        out: Tensor = self.to_out(layout.attend(q, k, v).flatten(-2))
        return out


class CrossAttention(_HeadNorms):
    """Attention of the tokens to the context of their sample, such as image tokens.

    Args:
        channels: C of the tokens.
        context_channels: channels of the context.
        heads: H; C must be a multiple of it.
        qk_rms_norm: normalise queries and keys per head.

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
        out: Tensor = self.to_out(layout.attend_to(q, k, v).flatten(-2))
        return out
