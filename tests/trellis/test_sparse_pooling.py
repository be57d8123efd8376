"""Pooling and its inverse against golden vectors and the readable twin."""

from __future__ import annotations

import pytest
import torch
from hypothesis import given
from hypothesis import strategies as st
from tests.trellis.sparse_samples import COUNTS, SEEDS, examples, random_sparse

from recast.core.errors import InputError
from recast.trellis.sparse import SparseTensor, pool, pool_reference, unpool
from support.trellis import assert_same, golden_tensors


def test_golden_pooling() -> None:
    ops = golden_tensors("ops")
    x = SparseTensor(ops["coords"], ops["feats"], 2)
    coarse, index = pool(x)
    assert torch.equal(coarse.coords, ops["down_coords"])
    assert_same(coarse.feats, ops["down_feats"])
    fine = unpool(coarse, index)
    assert torch.equal(fine.coords, x.coords)
    assert_same(fine.feats, ops["up_feats"])


@examples
@given(SEEDS, COUNTS, st.integers(2, 3))
def test_equals_the_twin(seed: int, counts: list[int], factor: int) -> None:
    x = random_sparse(seed, counts, 3, low=-3)
    coarse, index = pool(x, factor)
    twin = pool_reference(x, factor)
    coarse.validate()
    assert torch.equal(coarse.coords, twin.coords)
    assert coarse.batch_size == x.batch_size
    torch.testing.assert_close(coarse.feats, twin.feats)
    fine = unpool(coarse, index)
    place = {tuple(c): i for i, c in enumerate(coarse.coords.tolist())}
    for row, (batch, *voxel) in enumerate(x.coords.tolist()):
        parent = place[batch, *(c // factor for c in voxel)]
        assert torch.equal(fine.feats[row], coarse.feats[parent])


def test_one_full_voxel_counts_one_child_too_many() -> None:
    voxels = torch.cartesian_prod(*[torch.arange(2)] * 3)
    coarse, _ = pool(SparseTensor.stack([voxels], [torch.ones(8, 1)]))
    assert coarse.feats.item() == pytest.approx(8 / 9)


def test_gradients() -> None:
    x = random_sparse(1, [12, 0, 7], 2, resolution=4)
    x.feats.requires_grad_()

    def there_and_back(feats: torch.Tensor) -> torch.Tensor:
        coarse, index = pool(x.with_feats(feats))
        return unpool(coarse.with_feats(coarse.feats.sin()), index).feats

    assert torch.autograd.gradcheck(there_and_back, x.feats)


def test_the_index_and_what_hangs_on_it_are_kept() -> None:
    x = random_sparse(1, [30], 2)
    first, index = pool(x)
    second, again = pool(x.with_feats(x.feats + 1))
    assert again is index
    assert second.cache is first.cache
    assert unpool(first, index).cache is x.cache


def test_a_tensor_without_rows() -> None:
    x = random_sparse(0, [0, 0], 2)
    coarse, index = pool(x)
    assert coarse.feats.shape == (0, 2) and coarse.batch_size == 2
    assert unpool(coarse, index).feats.shape == (0, 2)


def test_a_voxel_given_twice_is_refused() -> None:
    twice = torch.zeros(2, 4, dtype=torch.int32)
    with pytest.raises(InputError, match="twice"):
        pool(SparseTensor(twice, torch.zeros(2, 1), 1))
