"""Attention within cubic windows of voxels (Swin transformer on sparse voxels)."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import torch
from torch import Tensor

from recast.trellis.sparse.packed import PackedTokens, attention, attention_reference
from recast.trellis.sparse.tensor import SparseTensor, voxel_keys


@dataclass(frozen=True, eq=False)
class WindowPartition:
    """The voxels of a sparse tensor, ordered so that windows of equal size lie together.

    Args:
        order: (T,) int64 rows, window after window, small windows first.
        inverse: (T,) int64 place of every row in `order`.
        buckets: (number of windows, voxels in each), in the order in which they lie in `order`.
    """

    order: Tensor
    inverse: Tensor
    buckets: list[tuple[int, int]]


def window_partition(x: SparseTensor, window: int, shift: int) -> WindowPartition:
    """Windows (batch, floor((c + shift) / window)) of the voxels of `x`, computed once."""
    key = ("windows", window, shift)
    cached: dict[Any, WindowPartition] = x.cache
    if key not in cached:
        keys = voxel_keys(window_cells(x, window, shift), margin=0).keys
        _, cell, counts = keys.unique(return_inverse=True, return_counts=True)
        # By size, then by window: equal sizes become one batch without padding.
        order = torch.argsort(counts[cell] * max(len(counts), 1) + cell, stable=True)
        inverse = torch.empty_like(order)
        inverse[order] = torch.arange(len(order), device=order.device)
        sizes, numbers = counts.unique(return_counts=True)
        buckets = list(zip(numbers.tolist(), sizes.tolist(), strict=True))
        cached[key] = WindowPartition(order, inverse, buckets)
    return cached[key]


class WindowedTokens(PackedTokens):
    """Tokens (T,C) in the rows of a sparse tensor; self attention within windows of voxels.

    A window holds the voxels of one sample with equal floor((c + shift) / window) on all axes: a
    plain shift, not a cyclic one, and windows at the border are smaller. Cross attention is as in
    `PackedTokens`.
    """

    def __init__(self, x: SparseTensor, window: int, shift: int) -> None:
        super().__init__(x)
        self.window = window
        self.shift = shift

    def attend(self, q: Tensor, k: Tensor, v: Tensor) -> Tensor:
        """softmax(q k^T / sqrt(D)) v within each window; all (T,H,D)."""
        partition = window_partition(self.x, self.window, self.shift)
        if not partition.buckets:
            return q + 0 * v.sum()
        q, k, v = (_Permute.apply(t, partition.order, partition.inverse) for t in (q, k, v))
        # Splitting gives one gradient for all parts; slices would give one of full size each.
        sizes = [number * size for number, size in partition.buckets]
        rows = [
            attention(*(t.unflatten(0, bucket) for t in part)).flatten(0, 1)
            for bucket, *part in zip(
                partition.buckets, q.split(sizes), k.split(sizes), v.split(sizes), strict=True
            )
        ]
        out: Tensor = _Permute.apply(torch.cat(rows), partition.inverse, partition.order)
        return out

    def attend_reference(self, q: Tensor, k: Tensor, v: Tensor) -> Tensor:
        """Readable twin of `attend`: one window after another."""
        cells = window_cells(self.x, self.window, self.shift)
        out = torch.zeros_like(q)
        for cell in cells.unique(dim=0):
            rows = torch.nonzero((cells == cell).all(1)).squeeze(1)
            out[rows] = attention_reference(q[rows], k[rows], v[rows])
        return out


def window_cells(x: SparseTensor, window: int, shift: int) -> Tensor:
    """(T,4) int32 window [batch, i, j, k] of every voxel."""
    moved = (x.coords[:, 1:] + shift).div(window, rounding_mode="floor")
    return torch.cat([x.coords[:, :1], moved], dim=1)


class _Permute(torch.autograd.Function):
    """Rows in another order; the gradient gathers by the inverse instead of scattering."""

    @staticmethod
    def forward(ctx: Any, rows: Tensor, order: Tensor, inverse: Tensor) -> Tensor:
        ctx.save_for_backward(order, inverse)
        return rows.index_select(0, order)

    @staticmethod
    def backward(ctx: Any, *grads: Tensor) -> tuple[Tensor, None, None]:
        order, inverse = ctx.saved_tensors
        return _Permute.apply(grads[0], inverse, order), None, None
