"""Submanifold 3x3x3 convolution: as many voxels out as in, absent ones count as zero.

Three ways: one matrix product over all 27 gathered neighbours (im2col), one per tap over the pairs
that exist, or spconv where it is installed and the tensor is on CUDA.
"""

from __future__ import annotations

import math
from collections.abc import Iterator
from functools import cache
from types import ModuleType
from typing import Any

import torch
from torch import Tensor, nn
from torch.autograd.function import once_differentiable

from recast.core.errors import InputError
from recast.trellis.sparse import CENTRE, OFFSETS, NeighbourMap, SparseTensor, neighbour_map

SPCONV_DTYPES = (torch.float32, torch.float16)
IM2COL_ELEMENTS = 1 << 20
"""Gathered features held at a time: 4 MiB in float32, which the processor's caches hold."""
PAIR_ELEMENTS = 1 << 22
"""Gathered features held at a time: 16 MiB in float32, whatever the number of channels."""


class SubMConv3d(nn.Module):
    """Convolution over the occupied 3x3x3 neighbours of every occupied voxel.

    out[p] = bias + sum over (a,b,c) of W[:,a,b,c,:] x[p + (a-1,b-1,c-1)], over the voxels that
    exist in the sample (Graham et al., 3D Semantic Segmentation with Submanifold Sparse
    Convolutional Networks, 2018). Parameters: `conv.weight` (out,3,3,3,in), `conv.bias` (out,), as
    in the published TRELLIS checkpoints.
    """

    def __init__(self, in_channels: int, out_channels: int, bias: bool = True) -> None:
        super().__init__()
        self.in_channels = in_channels
        self.out_channels = out_channels
        self.conv = _Kernel(in_channels, out_channels, bias)

    def forward(self, x: SparseTensor) -> SparseTensor:
        """(T,in) features to (T,out) on the same voxels."""
        return submanifold_convolution(x, self.conv.weight, self.conv.bias)


class _Kernel(nn.Module):
    """Weight and bias, initialised as torch's own convolutions are."""

    bias: nn.Parameter | None

    def __init__(self, in_channels: int, out_channels: int, bias: bool) -> None:
        super().__init__()
        self.weight = nn.Parameter(torch.empty(out_channels, 3, 3, 3, in_channels))
        self.register_parameter("bias", nn.Parameter(torch.empty(out_channels)) if bias else None)
        bound = 1 / math.sqrt(27 * in_channels)
        for parameter in self.parameters():
            nn.init.uniform_(parameter, -bound, bound)


def submanifold_convolution(x: SparseTensor, weight: Tensor, bias: Tensor | None) -> SparseTensor:
    """Convolve `x` (T,in) with `weight` (out,3,3,3,in) and `bias` (out,): (T,out).

    Gathered matrix products: one over all 27 neighbours where channels are narrow or voxels few,
    else one per tap; or spconv where it is installed and the features are on CUDA.
    Differentiable once, in features, weight and bias; under autocast it runs in its dtype.

    Raises:
        InputError: channels that do not fit, or a voxel that stands twice.
    """
    if weight.shape[1:4] != (3, 3, 3) or weight.shape[4] != x.feats.shape[1]:
        found = f"weight {tuple(weight.shape)} for {x.feats.shape[1]} channels"
        raise InputError("submanifold convolution", "weight", found, "give (out,3,3,3,in)")
    device = x.feats.device.type
    if torch.is_autocast_enabled(device):
        dtype = torch.get_autocast_dtype(device)
        x, weight = x.with_feats(x.feats.to(dtype)), weight.to(dtype)
        bias = None if bias is None else bias.to(dtype)
    out: Tensor
    if spconv_usable(x):
        out = spconv_convolution(x, weight)
    elif _few_products(x, weight):
        out = Im2colGemm.apply(x.feats, weight.flatten(1, 3), neighbour_map(x).table)
    else:
        out = PairGemm.apply(x.feats, weight.flatten(1, 3), neighbour_map(x))
    return x.with_feats(out if bias is None else out + bias)


def _few_products(x: SparseTensor, weight: Tensor) -> bool:
    """Whether the number of calls, not of products, decides the time.

    Measured on a CPU, forward and backward, car-like surfaces of 300 to 20000 voxels: one product
    over all neighbours takes 0.15 to 0.9 of the time of one per tap up to 32 channels, and 0.7 for
    1000 voxels of 64; then 1.1 to 2.2 of it.
    """
    products = weight.shape[0] * weight.shape[4]
    return products <= 32 * 32 or products * len(x.feats) <= 1 << 22


def submanifold_convolution_reference(
    x: SparseTensor, weight: Tensor, bias: Tensor | None
) -> SparseTensor:
    """Readable twin of `submanifold_convolution`: voxel by voxel through a dictionary."""
    row_of = {tuple(voxel): row for row, voxel in enumerate(x.coords.tolist())}
    taps = weight.flatten(1, 3)  # (out, 27, in)
    rows = []
    for batch, i, j, k in row_of:
        total = x.feats.new_zeros(weight.shape[0]) if bias is None else bias
        for tap, (di, dj, dk) in enumerate(OFFSETS):
            row = row_of.get((batch, i + di, j + dj, k + dk))
            if row is not None:
                total = total + taps[:, tap] @ x.feats[row]
        rows.append(total)
    return x.with_feats(torch.stack(rows) if rows else x.feats.new_zeros(0, weight.shape[0]))


class Im2colGemm(torch.autograd.Function):
    """Features (T,in), taps (out,27,in) and a `NeighbourMap.table` (T,27) to (T,out).

    Absent neighbours are gathered as zeros, so that most of the products are wasted on a surface;
    but few calls are made, and with narrow channels or few voxels calls cost more than products.
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
            padded, length = _padded(feats), _im2col_rows(feats)
            for rows, part in zip(table.split(length), grad.split(length), strict=True):
                total += (part.T @ _neighbourhoods(padded, rows)).view_as(total)
            grad_taps = total.to(taps.dtype)
        return grad_feats, grad_taps, None


def _convolve(feats: Tensor, taps: Tensor, table: Tensor) -> Tensor:
    kernel = taps.flatten(1).T
    padded = _padded(feats)
    parts = [_neighbourhoods(padded, rows) @ kernel for rows in table.split(_im2col_rows(feats))]
    return parts[0] if len(parts) == 1 else torch.cat(parts)


def _padded(feats: Tensor) -> Tensor:
    """A row of zeros at the end, which absent neighbours point to."""
    return torch.cat([feats, feats.new_zeros(1, feats.shape[1])])


def _neighbourhoods(padded: Tensor, rows: Tensor) -> Tensor:
    """(t,27) rows to (t,27*C) features."""
    gathered = padded.index_select(0, rows.flatten())
    return gathered.view(rows.shape[0], rows.shape[1] * padded.shape[1])


def _im2col_rows(feats: Tensor) -> int:
    return max(1, IM2COL_ELEMENTS // (27 * max(feats.shape[1], 1)))


class PairGemm(torch.autograd.Function):
    """Features (T,in) and taps (out,27,in) to (T,out); sums of half precision are kept in float32.

    On a surface about 11 of the 27 neighbours exist, so that gathering all of them would multiply
    zeros for more than half of the time and hold 27 copies of the features. Within one tap no row
    appears twice, so that adding the products to their rows has one fixed order.
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
    length = max(1, PAIR_ELEMENTS // max(taps.shape[0], taps.shape[2], 1))
    for tap in range(len(OFFSETS)):
        if tap != CENTRE:
            pieces = (side.split(length) for side in neighbours.of(tap))
            for rows, sources in zip(*pieces, strict=True):
                yield tap, rows, sources


def _sum_dtype(feats: Tensor) -> torch.dtype:
    return torch.promote_types(feats.dtype, torch.float32)


def spconv_usable(x: SparseTensor) -> bool:
    """Whether `x` has rows, is on CUDA, of a dtype of spconv's kernels, and spconv imports."""
    on_cuda = x.feats.is_cuda and x.feats.dtype in SPCONV_DTYPES and len(x.feats) > 0
    return on_cuda and spconv() is not None


@cache
def spconv() -> ModuleType | None:
    """`spconv.pytorch`, or None where it is not installed or does not fit this torch or CUDA."""
    try:
        import spconv.pytorch as module
    except (ImportError, OSError):
        return None
    return module


def spconv_convolution(x: SparseTensor, weight: Tensor) -> Tensor:
    """Convolve `x` (T,in) with `weight` (out,3,3,3,in), spconv's own layout: (T,out), no bias.

    spconv's pairs of neighbours are kept in the cache of `x`, one set for all layers.

    Not run on CUDA in this project's tests, which have no GPU; the forward calls agree with the
    golden vectors through spconv 2.3.8's CPU wheel on one thread. (On several threads that wheel's
    results change from call to call, and it has no backward pass: one more reason to take spconv on
    CUDA alone.)
    """
    module = spconv()
    assert module is not None
    if "spconv" not in x.cache:
        low = x.coords.amin(0)
        low[0] = 0
        coords = (x.coords - low).contiguous()
        x.cache["spconv"] = (coords, (coords[:, 1:].amax(0) + 1).tolist())
    coords, shape = x.cache["spconv"]
    pairs = x.cache.get("spconv_pairs", {})
    tensor = module.SparseConvTensor(x.feats, coords, shape, x.batch_size, indice_dict=pairs)
    layer = _layer(weight.shape[4], weight.shape[0])
    result: Any = torch.func.functional_call(layer, {"weight": weight}, (tensor,))
    x.cache["spconv_pairs"] = result.indice_dict
    return result.features


@cache
def _layer(in_channels: int, out_channels: int) -> Any:
    """A layer of spconv to lend our weight to; its own weight holds no memory."""
    module = spconv()
    assert module is not None
    with torch.device("meta"):
        return module.SubMConv3d(in_channels, out_channels, 3, bias=False, indice_key="subm")
