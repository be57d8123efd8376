"""Submanifold 3x3x3 convolution: as many voxels out as in, absent ones count as zero."""

from __future__ import annotations

import math

import torch
from torch import Tensor, nn

from recast.errors import InputError
from recast.trellis.sparse import spconv_backend
from recast.trellis.sparse.im2col_gemm import Im2colGemm
from recast.trellis.sparse.neighbours import OFFSETS, neighbour_map
from recast.trellis.sparse.pair_gemm import PairGemm
from recast.trellis.sparse.tensor import SparseTensor


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

    def extra_repr(self) -> str:
        """Channels in and out."""
        return f"{self.in_channels}, {self.out_channels}"


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
    if spconv_backend.usable(x):
        out = spconv_backend.spconv_convolution(x, weight)
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
