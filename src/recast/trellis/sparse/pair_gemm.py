"""The submanifold convolution as one matrix product per tap, over the pairs that exist.

On a surface about 11 of the 27 neighbours exist, so that gathering all of them would multiply zeros
for more than half of the time and hold 27 copies of the features. Within one tap no row appears
twice, so that adding the products to their rows has one fixed order.
"""

from __future__ import annotations

from collections.abc import Iterator
from typing import Any

import torch
from torch import Tensor
from torch.autograd.function import once_differentiable

from recast.trellis.sparse.neighbours import CENTRE, OFFSETS, NeighbourMap

CHUNK_ELEMENTS = 1 << 22
"""Gathered features held at a time: 16 MiB in float32, whatever the number of channels."""


class PairGemm(torch.autograd.Function):
    """Features (T,in) and taps (out,27,in) to (T,out); sums of half precision are kept in float32.

    Differentiable once, in features and taps.
    """

    @staticmethod
    def forward(ctx: Any, feats: Tensor, taps: Tensor, neighbours: NeighbourMap) -> Tensor:
        """Products of the pairs of each tap, added to the rows they belong to."""
        ctx.save_for_backward(feats, taps)
        ctx.neighbours = neighbours
        out = (feats @ taps[:, CENTRE].T).to(_sum_dtype(feats))
        for tap, rows, sources in _chunks(neighbours, taps):
            products = feats.index_select(0, sources) @ taps[:, tap].T
            out.index_add_(0, rows, products.to(out.dtype))
        return out.to(feats.dtype)

    @staticmethod
    @once_differentiable
    def backward(ctx: Any, *grads: Tensor) -> tuple[Tensor | None, Tensor | None, None]:
        """The same pairs read backwards; one gather of the gradient serves both results."""
        feats, taps = ctx.saved_tensors
        (grad,) = grads
        for_feats, for_taps = ctx.needs_input_grad[:2]
        grad_feats = grad_taps = None
        if for_feats:
            grad_feats = (grad @ taps[:, CENTRE]).to(_sum_dtype(feats))
        if for_taps:
            grad_taps = torch.zeros_like(taps, dtype=_sum_dtype(feats))
            grad_taps[:, CENTRE] = grad.T @ feats
        for tap, rows, sources in _chunks(ctx.neighbours, taps):
            part = grad.index_select(0, rows)
            if grad_feats is not None:
                grad_feats.index_add_(0, sources, (part @ taps[:, tap]).to(grad_feats.dtype))
            if grad_taps is not None:
                grad_taps[:, tap] += part.T @ feats.index_select(0, sources)
        return (
            None if grad_feats is None else grad_feats.to(feats.dtype),
            None if grad_taps is None else grad_taps.to(taps.dtype),
            None,
        )


def _chunks(neighbours: NeighbourMap, taps: Tensor) -> Iterator[tuple[int, Tensor, Tensor]]:
    """(tap, rows, sources) of all taps but the centre, in pieces of bounded size."""
    length = max(1, CHUNK_ELEMENTS // max(taps.shape[0], taps.shape[2], 1))
    for tap in range(len(OFFSETS)):
        if tap != CENTRE:
            pieces = (side.split(length) for side in neighbours.of(tap))
            for rows, sources in zip(*pieces, strict=True):
                yield tap, rows, sources


def _sum_dtype(feats: Tensor) -> torch.dtype:
    return torch.promote_types(feats.dtype, torch.float32)
