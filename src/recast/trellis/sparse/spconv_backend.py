"""The submanifold convolution through spconv, where it is installed and the tensor is on CUDA.

Not run on CUDA in this project's tests, which have no GPU; the forward calls agree with the
golden vectors through spconv 2.3.8's CPU wheel on one thread. (On several threads that wheel's
results change from call to call, and it has no backward pass: one more reason to take spconv on
CUDA alone.)
"""

from __future__ import annotations

from functools import cache
from types import ModuleType
from typing import Any

import torch
from torch import Tensor

from recast.trellis.sparse.tensor import SparseTensor

DTYPES = (torch.float32, torch.float16)


def usable(x: SparseTensor) -> bool:
    """Whether `x` has rows, is on CUDA, of a dtype of spconv's kernels, and spconv imports."""
    on_cuda = x.feats.is_cuda and x.feats.dtype in DTYPES and len(x.feats) > 0
    return on_cuda and spconv() is not None


@cache
def spconv() -> ModuleType | None:
    """`spconv.pytorch`, or None where it is not installed or does not fit this torch or CUDA."""
    try:
        import spconv.pytorch as module
    except (ImportError, OSError):
        return None
    found: ModuleType = module
    return found


def spconv_convolution(x: SparseTensor, weight: Tensor) -> Tensor:
    """Convolve `x` (T,in) with `weight` (out,3,3,3,in), spconv's own layout: (T,out), no bias.

    spconv's pairs of neighbours are kept in the cache of `x`, one set for all layers.
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
    features: Tensor = result.features
    return features


@cache
def _layer(in_channels: int, out_channels: int) -> Any:
    """A layer of spconv to lend our weight to; its own weight holds no memory."""
    module = spconv()
    assert module is not None
    with torch.device("meta"):
        return module.SubMConv3d(in_channels, out_channels, 3, bias=False, indice_key="subm")
