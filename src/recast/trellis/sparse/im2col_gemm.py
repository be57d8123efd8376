"""The submanifold convolution as one matrix product over all 27 gathered neighbours (im2col).

Absent neighbours are gathered as zeros, so that most of the products are wasted on a surface; but
few calls are made, and with narrow channels or few voxels calls cost more than products.
"""

from __future__ import annotations

from typing import Any

import torch
from torch import Tensor
from torch.autograd.function import once_differentiable

CHUNK_ELEMENTS = 1 << 20
"""Gathered features held at a time: 4 MiB in float32, which the processor's caches hold."""


class Im2colGemm(torch.autograd.Function):
    """Features (T,in), taps (out,27,in) and a `NeighbourMap.table` (T,27) to (T,out).

    Differentiable once, in features and taps.
    """

    @staticmethod
    def forward(ctx: Any, feats: Tensor, taps: Tensor, table: Tensor) -> Tensor:
        """Rows of all neighbours side by side, times the whole kernel."""
        ctx.save_for_backward(feats, taps, table)
        return _convolve(feats, taps, table)

    @staticmethod
    @once_differentiable
    def backward(ctx: Any, *grads: Tensor) -> tuple[Tensor | None, Tensor | None, None]:
        """The convolution of the gradient with the mirrored kernel; no row is ever scattered."""
        feats, taps, table = ctx.saved_tensors
        (grad,) = grads
        grad_feats = grad_taps = None
        if ctx.needs_input_grad[0]:
            grad_feats = _convolve(grad, taps.flip(1).transpose(0, 2), table)
        if ctx.needs_input_grad[1]:
            total = torch.zeros_like(taps, dtype=torch.promote_types(taps.dtype, torch.float32))
            padded, length = _padded(feats), _chunk(feats)
            for rows, part in zip(table.split(length), grad.split(length), strict=True):
                total += (part.T @ _neighbourhoods(padded, rows)).view_as(total)
            grad_taps = total.to(taps.dtype)
        return grad_feats, grad_taps, None


def _convolve(feats: Tensor, taps: Tensor, table: Tensor) -> Tensor:
    kernel = taps.flatten(1).T
    padded = _padded(feats)
    parts = [_neighbourhoods(padded, rows) @ kernel for rows in table.split(_chunk(feats))]
    return parts[0] if len(parts) == 1 else torch.cat(parts)


def _padded(feats: Tensor) -> Tensor:
    """A row of zeros at the end, which absent neighbours point to."""
    return torch.cat([feats, feats.new_zeros(1, feats.shape[1])])


def _neighbourhoods(padded: Tensor, rows: Tensor) -> Tensor:
    """(t,27) rows to (t,27*C) features."""
    gathered = padded.index_select(0, rows.flatten())
    return gathered.view(rows.shape[0], rows.shape[1] * padded.shape[1])


def _chunk(feats: Tensor) -> int:
    return max(1, CHUNK_ELEMENTS // (27 * max(feats.shape[1], 1)))
