"""Token layouts: attention per sample and per window, against golden windows and twins."""

from __future__ import annotations

import pytest
import torch
from hypothesis import given
from hypothesis import strategies as st
from tests.trellis.sparse_samples import COUNTS, SEEDS, examples, normal, random_sparse
from torch import Tensor

from recast.trellis.sparse import (
    PackedTokens,
    SparseTensor,
    WindowedTokens,
    attention_reference,
    window_partition,
)
from support.trellis import golden_tensors


def heads(seed: int, x: SparseTensor) -> tuple[Tensor, ...]:
    return normal(seed, 3, len(x.coords), 2, 4).unbind()


@pytest.mark.parametrize("shift", [0, 2])
def test_golden_windows(shift: int) -> None:
    ops = golden_tensors("ops")
    x = SparseTensor(ops["coords"], ops["feats"], 2)
    partition = window_partition(x, 4, shift)
    sizes = [size for number, size in partition.buckets for _ in range(number)]
    expected = ops[f"win_shift{shift}_fwd"].split(ops[f"win_shift{shift}_seqlens"].tolist())
    found = {frozenset(rows.tolist()) for rows in partition.order.split(sizes)}
    assert found == {frozenset(rows.tolist()) for rows in expected}
    assert torch.equal(partition.order[partition.inverse], torch.arange(290))


@examples
@given(SEEDS, COUNTS, st.integers(1, 5), st.integers(0, 4))
def test_windowed_equals_the_loop(seed: int, counts: list[int], window: int, shift: int) -> None:
    x = random_sparse(seed, counts, 1, low=-3)
    layout = WindowedTokens(x, window, shift)
    q, k, v = heads(seed, x)
    torch.testing.assert_close(layout.attend(q, k, v), layout.attend_reference(q, k, v))


@examples
@given(SEEDS, COUNTS)
def test_packed_equals_the_loop(seed: int, counts: list[int]) -> None:
    x = random_sparse(seed, counts, 1)
    layout = PackedTokens(x)
    q, k, v = heads(seed, x)
    torch.testing.assert_close(layout.attend(q, k, v), layout.attend_reference(q, k, v))
    context = normal(seed, 2, len(counts), 5, 2, 4)
    expected = [attention_reference(q[s], *context[:, i]) for i, s in enumerate(x.slices)]
    torch.testing.assert_close(layout.attend_to(q, *context), torch.cat(expected))


@examples
@given(SEEDS, COUNTS)
def test_spread_gives_every_token_its_samples_value(seed: int, counts: list[int]) -> None:
    x = random_sparse(seed, counts, 1)
    values = normal(seed, len(counts), 3)
    found = PackedTokens(x).spread(values).expand(len(x.coords), 3)
    assert torch.equal(found, values[x.batch])


def layouts(x: SparseTensor) -> list[PackedTokens]:
    return [PackedTokens(x), WindowedTokens(x, 2, 1)]


@pytest.mark.parametrize("which", [0, 1])
def test_gradients(which: int) -> None:
    x = random_sparse(2, [8, 0, 5], 1, resolution=3)
    layout = layouts(x)[which]
    inputs = [t.clone().requires_grad_() for t in heads(0, x)]
    assert torch.autograd.gradcheck(layout.attend, inputs)
    context = [t.clone().requires_grad_() for t in normal(1, 2, 3, 2, 2, 4)]
    assert torch.autograd.gradcheck(layout.attend_to, [inputs[0], *context])
    assert torch.autograd.gradcheck(layout.spread, normal(2, 3, 2).requires_grad_())


@pytest.mark.parametrize("which", [0, 1])
@pytest.mark.parametrize("counts", [[0], [0, 0]])
def test_no_tokens_at_all(which: int, counts: list[int]) -> None:
    x = random_sparse(0, counts, 1)
    layout = layouts(x)[which]
    q, k, v = (t.requires_grad_() for t in heads(0, x))
    context = normal(1, 2, len(counts), 2, 2, 4).requires_grad_()
    out = layout.attend(q, k, v) + layout.attend_to(q, *context)
    assert out.shape == (0, 2, 4)
    out.sum().backward()
    assert context.grad is not None and not context.grad.any()


def test_a_windows_partition_is_computed_once() -> None:
    x = random_sparse(0, [20], 1)
    assert window_partition(x, 4, 0) is window_partition(x.with_feats(x.feats + 1), 4, 0)
    assert window_partition(x, 4, 0) is not window_partition(x, 4, 2)
