"""Sparse voxels: tensors, neighbours, submanifold convolution, pooling and token layouts."""

from recast.trellis.sparse.convolution import (
    SubMConv3d,
    submanifold_convolution,
    submanifold_convolution_reference,
)
from recast.trellis.sparse.tensor import NeighbourMap, SparseTensor, neighbour_map
from recast.trellis.sparse.tokens import (
    PackedTokens,
    PoolIndex,
    WindowedTokens,
    WindowPartition,
    attention,
    pool,
    pool_reference,
    unpool,
    window_partition,
)

__all__ = [
    "NeighbourMap",
    "PackedTokens",
    "PoolIndex",
    "SparseTensor",
    "SubMConv3d",
    "WindowPartition",
    "WindowedTokens",
    "attention",
    "neighbour_map",
    "pool",
    "pool_reference",
    "submanifold_convolution",
    "submanifold_convolution_reference",
    "unpool",
    "window_partition",
]
