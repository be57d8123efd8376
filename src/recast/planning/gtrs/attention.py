"""Post-norm transformer layers of the head; all attention is scaled dot-product attention.

Parameters are named as in the released checkpoints: those of the decoder are PyTorch's
`nn.TransformerDecoderLayer`, whose own evaluation path may build the whole score matrix (2 GB for
8192 trajectories).
"""

from __future__ import annotations

import torch
from torch import Tensor, nn
from torch.nn import functional


def attend(q: Tensor, k: Tensor, v: Tensor, heads: int) -> Tensor:
    """Multi-head attention of (B, Q, d) queries to (B, K, d) keys and values; scale 1/sqrt(d/H)."""
    q, k, v = (x.unflatten(-1, (heads, -1)).transpose(-2, -3) for x in (q, k, v))
    return functional.scaled_dot_product_attention(q, k, v).transpose(-2, -3).flatten(-2)


class BiasedAttention(nn.Module):
    """Attention with the parameters of `nn.MultiheadAttention`."""

    def __init__(self, channels: int, heads: int) -> None:
        super().__init__()
        self.heads = heads
        self.in_proj_weight = nn.Parameter(torch.empty(3 * channels, channels))
        self.in_proj_bias = nn.Parameter(torch.empty(3 * channels))
        self.out_proj = nn.Linear(channels, channels)

    def forward(self, queries: Tensor, context: Tensor) -> Tensor:
        """Queries (B, Q, d) and context (B, K, d) to (B, Q, d)."""
        d = queries.shape[-1]
        q = functional.linear(queries, self.in_proj_weight[:d], self.in_proj_bias[:d])
        k, v = functional.linear(context, self.in_proj_weight[d:], self.in_proj_bias[d:]).chunk(
            2, dim=-1
        )
        out: Tensor = self.out_proj(attend(q, k, v, self.heads))
        return out


class UnbiasedAttention(nn.Module):
    """Self-attention with four projections without bias."""

    def __init__(self, channels: int, heads: int) -> None:
        super().__init__()
        self.heads = heads
        self.to_q = nn.Linear(channels, channels, bias=False)
        self.to_k = nn.Linear(channels, channels, bias=False)
        self.to_v = nn.Linear(channels, channels, bias=False)
        self.to_out = nn.Linear(channels, channels, bias=False)

    def forward(self, x: Tensor) -> Tensor:
        """(B, L, d) to (B, L, d)."""
        out: Tensor = self.to_out(attend(self.to_q(x), self.to_k(x), self.to_v(x), self.heads))
        return out


class EncoderLayer(nn.Module):
    """The trajectories of a vocabulary attend to one another."""

    def __init__(self, channels: int, heads: int) -> None:
        super().__init__()
        self.self_attn = UnbiasedAttention(channels, heads)
        self.linear1 = nn.Linear(channels, 4 * channels)
        self.linear2 = nn.Linear(4 * channels, channels)
        self.norm1 = nn.LayerNorm(channels)
        self.norm3 = nn.LayerNorm(channels)  # there is no second one, nor was there in the release

    def forward(self, x: Tensor) -> Tensor:
        """(B, L, d) to (B, L, d)."""
        x = self.norm1(x + self.self_attn(x))
        out: Tensor = self.norm3(x + self.linear2(functional.relu(self.linear1(x))))
        return out


class DecoderLayer(nn.Module):
    """Self-attention, cross-attention to the image, feed-forward; in two callable halves."""

    def __init__(self, channels: int, heads: int, feedforward: int) -> None:
        super().__init__()
        self.self_attn = BiasedAttention(channels, heads)
        self.multihead_attn = BiasedAttention(channels, heads)
        self.linear1 = nn.Linear(channels, feedforward)
        self.linear2 = nn.Linear(feedforward, channels)
        self.norm1 = nn.LayerNorm(channels)
        self.norm2 = nn.LayerNorm(channels)
        self.norm3 = nn.LayerNorm(channels)

    def look_at_each_other(self, x: Tensor) -> Tensor:
        """Self-attention and first norm, (B, L, d): all of the layer that needs no image."""
        out: Tensor = self.norm1(x + self.self_attn(x, x))
        return out

    def look_at_image(self, x: Tensor, image_tokens: Tensor) -> Tensor:
        """The rest of the layer: (B, L, d) and image tokens (B, T, d) to (B, L, d)."""
        x = self.norm2(x + self.multihead_attn(x, image_tokens))
        out: Tensor = self.norm3(x + self.linear2(functional.relu(self.linear1(x))))
        return out

    def forward(self, x: Tensor, image_tokens: Tensor) -> Tensor:
        """The whole layer: (B, L, d) and image tokens (B, T, d) to (B, L, d)."""
        return self.look_at_image(self.look_at_each_other(x), image_tokens)


class Decoder(nn.Module):
    """A stack of decoder layers."""

    def __init__(self, channels: int, heads: int, feedforward: int, layers: int) -> None:
        super().__init__()
        self.layers = nn.ModuleList(
            DecoderLayer(channels, heads, feedforward) for _ in range(layers)
        )

    @property
    def first(self) -> DecoderLayer:
        """The layer whose self-attention sees nothing but the vocabulary."""
        layer = self.layers[0]
        assert isinstance(layer, DecoderLayer)
        return layer

    def forward(self, x: Tensor, image_tokens: Tensor) -> Tensor:
        """All layers but the first one's self-attention, which `x` has been through."""
        x = self.first.look_at_image(x, image_tokens)
        for layer in self.layers[1:]:
            x = layer(x, image_tokens)
        return x
