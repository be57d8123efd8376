"""Attention over the voxels of each sample, packed one after another."""

from __future__ import annotations

import torch
from torch import Tensor
from torch.nn.functional import scaled_dot_product_attention

from recast.trellis.sparse.tensor import SparseTensor


class PackedTokens:
    """Tokens (T,C) of several samples, in the rows of a sparse tensor; full attention per sample.

    Args:
        x: the voxels; its features are not used.
    """

    def __init__(self, x: SparseTensor) -> None:
        self.x = x

    def spread(self, per_sample: Tensor) -> Tensor:
        """(B,...) values of the samples, to be combined with their tokens: (T,...) or (1,...)."""
        if self.x.batch_size == 1:
            return per_sample
        # Expanding adds the gradient up per sample in one fixed order; indexing would scatter it.
        shape = per_sample.shape[1:]
        return torch.cat(
            [row.expand(n, *shape) for row, n in zip(per_sample, self.x.counts, strict=True)]
        )

    def attend(self, q: Tensor, k: Tensor, v: Tensor) -> Tensor:
        """softmax(q k^T / sqrt(D)) v within each sample; all (T,H,D)."""
        counts = self.x.counts
        parts = zip(q.split(counts), k.split(counts), v.split(counts), strict=True)
        rows = [attention(*part) for part in parts]
        return rows[0] if len(rows) == 1 else torch.cat(rows)

    def attend_reference(self, q: Tensor, k: Tensor, v: Tensor) -> Tensor:
        """Readable twin of `attend`: one sample after another, weights written out."""
        return torch.cat([attention_reference(q[s], k[s], v[s]) for s in self.x.slices])

    def attend_to(self, q: Tensor, k: Tensor, v: Tensor) -> Tensor:
        """Queries (T,H,D) of each sample over that sample's context k, v (B,L,H,D)."""
        parts = zip(q.split(self.x.counts), k.unbind(), v.unbind(), strict=True)
        rows = [attention(*part) for part in parts]
        return rows[0] if len(rows) == 1 else torch.cat(rows)


def attention(q: Tensor, k: Tensor, v: Tensor) -> Tensor:
    """softmax(q k^T / sqrt(D)) v of (...,N,H,D) queries over (...,M,H,D) keys and values."""
    if q.numel() == 0:
        return q + 0 * v.sum()  # no token; still a part of the graph
    if q.ndim == 3:
        # Without an axis for the batch, torch writes out the matrix of weights.
        return attention(q[None], k[None], v[None])[0]
    out = scaled_dot_product_attention(
        q.transpose(-3, -2), k.transpose(-3, -2), v.transpose(-3, -2)
    )
    return out.transpose(-3, -2)


def attention_reference(q: Tensor, k: Tensor, v: Tensor) -> Tensor:
    """Readable twin of `attention`: the matrix of weights, written out."""
    scores = torch.einsum("...nhd,...mhd->...hnm", q, k) / q.shape[-1] ** 0.5
    return torch.einsum("...hnm,...mhd->...nhd", scores.softmax(-1), v)
