"""Sparse tensors: rows, samples, checks; the neighbours of voxels."""

from __future__ import annotations

import pytest
import torch
from hypothesis import given
from tests.trellis.sparse_samples import COUNTS, SEEDS, examples, one_sample, random_sparse

from recast.core.errors import InputError
from recast.trellis.sparse import CENTRE, OFFSETS, SparseTensor, neighbour_map


def test_samples_keep_their_rows_and_empty_ones_count() -> None:
    x = random_sparse(0, [0, 5, 0, 3, 0], 2)
    assert x.batch_size == 5
    assert x.counts == [0, 5, 0, 3, 0]
    assert x.slices[3] == slice(5, 8)
    assert x.batch.tolist() == [1] * 5 + [3] * 3
    alone = one_sample(x, 3)
    assert alone.batch_size == 1 and alone.counts == [3]
    assert torch.equal(alone.feats, x.feats[5:])
    assert torch.equal(alone.coords[:, 1:], x.coords[5:, 1:])
    assert one_sample(x, 4).counts == [0]


def test_other_features_share_what_the_coordinates_gave() -> None:
    x = random_sparse(0, [9], 2)
    neighbours = neighbour_map(x)
    other = x.with_feats(x.feats.float())
    assert neighbour_map(other) is neighbours
    assert neighbour_map(random_sparse(0, [9], 2)) is not neighbours


ROWS = torch.tensor([[0, 0, 0, 0], [0, 0, 0, 1], [1, 0, 0, 0]], dtype=torch.int32)


@pytest.mark.parametrize(
    ("coords", "feats", "batch_size", "said"),
    [
        (ROWS.long(), torch.zeros(3, 2), 2, "int32"),
        (ROWS[:, 1:], torch.zeros(3, 2), 2, r"\(3, 3\)"),
        (ROWS, torch.zeros(2, 2), 2, "one row per voxel"),
        (ROWS, torch.zeros(3, 2), 1, "0 to 1 in a batch of 1"),
        (ROWS.flip(0), torch.zeros(3, 2), 2, "not contiguous"),
        (ROWS[[0, 0, 2]], torch.zeros(3, 2), 2, "twice"),
    ],
)
def test_what_does_not_fit_is_named(
    coords: torch.Tensor, feats: torch.Tensor, batch_size: int, said: str
) -> None:
    with pytest.raises(InputError, match=said):
        SparseTensor(coords, feats, batch_size).validate()


def test_a_batch_needs_a_sample() -> None:
    with pytest.raises(InputError, match="one of each for every sample"):
        SparseTensor.stack([], [])


@examples
@given(SEEDS, COUNTS)
def test_neighbours_are_the_touching_voxels_of_the_sample(seed: int, counts: list[int]) -> None:
    x = random_sparse(seed, counts, 1, low=-3)
    voxels = [tuple(row) for row in x.coords.tolist()]
    rows = {voxel: row for row, voxel in enumerate(voxels)}
    neighbours = neighbour_map(x)
    for tap, step in enumerate(OFFSETS):
        if tap == CENTRE:
            continue
        expected = {
            (row, rows[moved])
            for row, (b, *c) in enumerate(voxels)
            if (moved := (b, *(i + d for i, d in zip(c, step, strict=True)))) in rows
        }
        found = list(zip(*(side.tolist() for side in neighbours.of(tap)), strict=True))
        assert len(found) == len(expected)
        assert set(found) == expected


def test_a_voxel_given_twice_has_no_neighbours() -> None:
    with pytest.raises(InputError, match="twice"):
        neighbour_map(SparseTensor(ROWS[[0, 0]], torch.zeros(2, 1), 1))
