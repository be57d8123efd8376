"""Random sparse tensors for the tests: some samples empty, rows of a sample in any order."""

from __future__ import annotations

import torch
from hypothesis import settings
from hypothesis import strategies as st
from torch import Tensor

from recast.trellis.sparse import SparseTensor


def random_sparse(
    seed: int, counts: list[int], channels: int, resolution: int = 6, low: int = 0
) -> SparseTensor:
    """Distinct voxels with coordinates from `low`, float64 features; `counts` rows per sample."""
    generator = torch.Generator().manual_seed(seed)
    coords, feats = [], []
    for count in counts:
        cells = torch.randperm(resolution**3, generator=generator)[:count]
        xyz = [cells // resolution**2, cells // resolution % resolution, cells % resolution]
        coords.append(torch.stack(xyz, dim=1) + low)
        feats.append(torch.randn(count, channels, generator=generator, dtype=torch.float64))
    return SparseTensor.stack(coords, feats)


def normal(seed: int, *shape: int) -> Tensor:
    return torch.randn(*shape, generator=torch.Generator().manual_seed(seed), dtype=torch.float64)


examples = settings(max_examples=40, deadline=None)
SEEDS = st.integers(0, 2**31)
COUNTS = st.lists(st.one_of(st.just(0), st.integers(1, 60)), min_size=1, max_size=3)


def one_sample(x: SparseTensor, index: int) -> SparseTensor:
    """One sample as a batch of one."""
    rows = x.slices[index]
    coords = x.coords[rows].clone()
    coords[:, 0] = 0
    return SparseTensor(coords, x.feats[rows], 1)
