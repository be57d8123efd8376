"""What attention runs over: the seam between the layers and dense, sparse or windowed tokens."""

from __future__ import annotations

from typing import Protocol

from torch import Tensor
from torch.nn import functional


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
        """Full self-attention, (B, N, H, D)."""
        return _attention(q, k, v)

    def attend_to(self, q: Tensor, k: Tensor, v: Tensor) -> Tensor:
        """Cross-attention of (B, N, H, D) to (B, L, H, D)."""
        return _attention(q, k, v)


def _attention(q: Tensor, k: Tensor, v: Tensor) -> Tensor:
    """Softmax attention with heads on the second last axis."""
    q, k, v = (x.transpose(1, 2) for x in (q, k, v))
    return functional.scaled_dot_product_attention(q, k, v).transpose(1, 2)
