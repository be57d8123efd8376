"""Coarser and finer voxels: pooling and its inverse."""

from __future__ import annotations

from dataclasses import dataclass, field
from typing import Any

import torch
from torch import Tensor

from recast.core.errors import InputError
from recast.trellis.sparse.tensor import SparseTensor, voxel_keys


@dataclass(frozen=True, eq=False)
class PoolIndex:
    """Which fine voxels lie in which coarse voxel.

    Args:
        fine: the fine voxels, without features (T,0).
        coarse: the coarse voxels, without features (T',0).
        parent: (T,) int64 row of the coarse voxel around each fine one.
        children: (factor^3,T') int64 rows of the fine voxels in each coarse one, by their place in
            it; T where there is none.
        counts: (T',) int64 number of fine voxels in each coarse one.
    """

    fine: SparseTensor
    coarse: SparseTensor
    parent: Tensor
    children: Tensor = field(repr=False)
    counts: Tensor = field(repr=False)


def pool(x: SparseTensor, factor: int = 2) -> tuple[SparseTensor, PoolIndex]:
    """Features on voxels `factor` times as large: the sum of the children over their count plus 1.

    The published networks were trained with this divisor (a mean in which the zero they sum onto
    counts as one more child), so it belongs to the weights.

    Returns:
        The coarse tensor, its rows in lexicographic order (batch, x, y, z), and the index that
        `unpool` needs.

    Raises:
        InputError: a voxel stands twice.
    """
    index = _pool_index(x, factor)
    total: Tensor = _SumOfChildren.apply(x.feats, index.parent, index.children)
    feats = total / (index.counts + 1).to(total.dtype).unsqueeze(1)
    return index.coarse.with_feats(feats), index


def unpool(coarse: SparseTensor, index: PoolIndex) -> SparseTensor:
    """Each fine voxel takes the features of the coarse voxel around it (nearest neighbour).

    The voxels and the order of the rows are those that were pooled.
    """
    feats: Tensor = _OfParent.apply(coarse.feats, index.parent, index.children)
    return index.fine.with_feats(feats)


def pool_reference(x: SparseTensor, factor: int = 2) -> SparseTensor:
    """Readable twin of `pool`, voxel by voxel."""
    families: dict[tuple[int, ...], list[int]] = {}
    for row, (batch, *voxel) in enumerate(x.coords.tolist()):
        families.setdefault((batch, *(c // factor for c in voxel)), []).append(row)
    ordered = sorted(families)
    feats = x.feats.new_zeros(len(ordered), x.feats.shape[1])
    for i, parent in enumerate(ordered):
        rows = families[parent]
        feats[i] = x.feats[rows].sum(0) / (len(rows) + 1)
    coords = torch.tensor(ordered, dtype=torch.int32, device=x.coords.device).reshape(-1, 4)
    return SparseTensor(coords, feats, x.batch_size)


def _pool_index(x: SparseTensor, factor: int) -> PoolIndex:
    cached: dict[Any, PoolIndex] = x.cache
    if ("pool", factor) not in cached:
        coords = x.coords.clone()
        coords[:, 1:] = x.coords[:, 1:].div(factor, rounding_mode="floor")
        keys = voxel_keys(coords, margin=0).keys
        _, parent, counts = keys.unique(return_inverse=True, return_counts=True)
        place = torch.zeros_like(parent)
        for axis in (1, 2, 3):
            place = place * factor + (x.coords[:, axis] - coords[:, axis] * factor)
        rows = torch.arange(len(parent), device=parent.device)
        children = parent.new_full((factor**3, len(counts)), len(parent))
        children[place, parent] = rows
        if not torch.equal(children[place, parent], rows):
            found = "a voxel stands twice in a sample"
            raise InputError("sparse tensor", "coords", found, "give every voxel once")
        first = children.amin(0)
        empty = x.feats.new_empty
        cached[("pool", factor)] = PoolIndex(
            x.with_feats(empty(len(parent), 0)),
            SparseTensor(coords[first], empty(len(counts), 0), x.batch_size),
            parent,
            children,
            counts,
        )
    return cached[("pool", factor)]


class _SumOfChildren(torch.autograd.Function):
    """(T,C) -> (T',C); gathers in both directions, so that the sums have one fixed order."""

    @staticmethod
    def forward(ctx: Any, feats: Tensor, parent: Tensor, children: Tensor) -> Tensor:
        ctx.save_for_backward(parent, children)
        padded = torch.cat([feats, feats.new_zeros(1, feats.shape[1])])
        total = feats.new_zeros(children.shape[1], feats.shape[1])
        for rows in children:
            total += padded.index_select(0, rows)
        return total

    @staticmethod
    def backward(ctx: Any, *grads: Tensor) -> tuple[Tensor, None, None]:
        parent, children = ctx.saved_tensors
        return _OfParent.apply(grads[0], parent, children), None, None


class _OfParent(torch.autograd.Function):
    """(T',C) -> (T,C): the transpose of `_SumOfChildren`."""

    @staticmethod
    def forward(ctx: Any, feats: Tensor, parent: Tensor, children: Tensor) -> Tensor:
        ctx.save_for_backward(parent, children)
        return feats.index_select(0, parent)

    @staticmethod
    def backward(ctx: Any, *grads: Tensor) -> tuple[Tensor, None, None]:
        parent, children = ctx.saved_tensors
        return _SumOfChildren.apply(grads[0], parent, children), None, None
