"""Submanifold convolution against golden vectors, the dense convolution and its twin."""

from __future__ import annotations

import pytest
import torch
from hypothesis import given
from tests.trellis.sparse_samples import COUNTS, SEEDS, examples, normal, one_sample, random_sparse
from torch.nn.functional import conv3d

from recast.core.errors import InputError
from recast.trellis import sparse_convolution
from recast.trellis.sparse import SparseTensor, neighbour_map
from recast.trellis.sparse_convolution import (
    SubMConv3d,
    submanifold_convolution,
    submanifold_convolution_reference,
)
from support.trellis import assert_same, golden_tensors


def golden() -> tuple[SparseTensor, SubMConv3d, torch.Tensor]:
    ops = golden_tensors("ops")
    layer = SubMConv3d(4, 6)
    layer.load_state_dict(
        {"conv.weight": ops["conv_weight_krsc"], "conv.bias": ops["conv_bias"]}, strict=True
    )
    return SparseTensor(ops["coords"], ops["feats"], 2), layer, ops["conv_out"]


def test_golden_convolution() -> None:
    x, layer, expected = golden()
    found = layer(x)
    assert_same(found.feats.detach(), expected)
    assert found.coords is x.coords
    twin = submanifold_convolution_reference(x, layer.conv.weight, layer.conv.bias)
    assert_same(twin.feats.detach(), expected)


@examples
@given(SEEDS, COUNTS)
def test_equals_the_dense_convolution(seed: int, counts: list[int]) -> None:
    x = random_sparse(seed, counts, 3)
    weight, bias = normal(seed, 4, 3, 3, 3, 3), normal(seed + 1, 4)
    grid = torch.zeros(len(counts), 3, 6, 6, 6, dtype=torch.float64)
    place = x.coords.long().unbind(1)
    grid[place[0], :, place[1], place[2], place[3]] = x.feats
    dense = conv3d(grid, weight.permute(0, 4, 1, 2, 3), bias, padding=1)
    expected = dense[place[0], :, place[1], place[2], place[3]]
    torch.testing.assert_close(submanifold_convolution(x, weight, bias).feats, expected)
    twin = submanifold_convolution_reference(x, weight, bias).feats
    torch.testing.assert_close(twin, expected)
    by_pairs = sparse_convolution.PairGemm.apply(x.feats, weight.flatten(1, 3), neighbour_map(x))
    torch.testing.assert_close(by_pairs + bias, expected)


@examples
@given(SEEDS, COUNTS)
def test_the_order_of_rows_within_a_sample_does_not_matter(seed: int, counts: list[int]) -> None:
    x = random_sparse(seed, counts, 3)
    weight = normal(seed, 2, 3, 3, 3, 3)
    generator = torch.Generator().manual_seed(seed)
    order = torch.cat(
        [s.start + torch.randperm(s.stop - s.start, generator=generator) for s in x.slices]
    )
    moved = SparseTensor(x.coords[order], x.feats[order], x.batch_size)
    expected = submanifold_convolution(x, weight, None).feats[order]
    torch.testing.assert_close(submanifold_convolution(moved, weight, None).feats, expected)


@examples
@given(SEEDS, COUNTS)
def test_samples_do_not_mix(seed: int, counts: list[int]) -> None:
    x = random_sparse(seed, counts, 2)
    weight = normal(seed, 2, 3, 3, 3, 2)
    together = submanifold_convolution(x, weight, None)
    for i in range(x.batch_size):
        alone = submanifold_convolution(one_sample(x, i), weight, None)
        torch.testing.assert_close(alone.feats, one_sample(together, i).feats)


@pytest.fixture(params=["pairs", "im2col", "pairs in pieces", "im2col in pieces"])
def way(request: pytest.FixtureRequest, monkeypatch: pytest.MonkeyPatch) -> str:
    """Either matrix product, whatever the shapes would choose, whole or in small pieces."""
    one, *pieces = request.param.split(" ", 1)
    monkeypatch.setattr(sparse_convolution, "_few_products", lambda x, weight: one == "im2col")
    if pieces:
        monkeypatch.setattr(sparse_convolution, "PAIR_ELEMENTS", 8)
        monkeypatch.setattr(sparse_convolution, "IM2COL_ELEMENTS", 8 * 27)
    return str(request.param)


@pytest.mark.usefixtures("way")
def test_gradients() -> None:
    x = random_sparse(3, [5, 0, 8], 2, resolution=3)
    inputs = [x.feats, normal(1, 3, 3, 3, 3, 2), normal(2, 3)]
    for tensor in inputs:
        tensor.requires_grad_()
    assert torch.autograd.gradcheck(
        lambda f, w, b: submanifold_convolution(x.with_feats(f), w, b).feats, inputs
    )


@pytest.mark.usefixtures("way")
def test_every_way_equals_the_twin() -> None:
    x = random_sparse(5, [80, 0, 30], 4, low=-2)
    weight = normal(1, 5, 3, 3, 3, 4)
    found = submanifold_convolution(x, weight, None).feats
    torch.testing.assert_close(found, submanifold_convolution_reference(x, weight, None).feats)


def test_shapes_choose_the_way() -> None:
    few, many = random_sparse(0, [50], 64), random_sparse(0, [3000], 64, resolution=20)
    weight = torch.zeros(64, 3, 3, 3, 64)
    assert sparse_convolution._few_products(few, weight)
    assert not sparse_convolution._few_products(many, weight)
    assert sparse_convolution._few_products(many, weight[:16, ..., :16])


@pytest.mark.usefixtures("way")
def test_a_tensor_without_rows() -> None:
    layer = SubMConv3d(2, 3).double()
    x = random_sparse(0, [0, 0], 2)
    found = layer(x)
    assert found.feats.shape == (0, 3) and found.batch_size == 2
    found.feats.sum().backward()
    assert layer.conv.weight.grad is not None and not layer.conv.weight.grad.any()


@pytest.mark.usefixtures("way")
@pytest.mark.parametrize("dtype", [torch.float16, torch.bfloat16])
def test_half_precision_sums_in_float32(dtype: torch.dtype) -> None:
    x = random_sparse(0, [150], 16)
    weight = normal(1, 16, 3, 3, 3, 16) / 20
    half = x.with_feats(x.feats.to(dtype))
    found = submanifold_convolution(half, weight.to(dtype), None).feats
    assert found.dtype == dtype
    exact = submanifold_convolution(
        half.with_feats(half.feats.double()), weight.to(dtype).double(), None
    )
    assert_same(found, exact.feats, 2 * torch.finfo(dtype).eps)


def test_autocast_chooses_the_dtype() -> None:
    layer, x = SubMConv3d(2, 3), random_sparse(0, [20], 2)
    x = x.with_feats(x.feats.float())
    with torch.autocast("cpu", torch.bfloat16):
        found = layer(x)
    assert found.feats.dtype == torch.bfloat16
    assert_same(found.feats.detach(), layer(x).feats.detach(), 2e-2)


def test_a_weight_for_other_channels_is_refused() -> None:
    with pytest.raises(InputError, match="2 channels"):
        SubMConv3d(3, 4).double()(random_sparse(0, [5], 2))


def test_builds_without_memory() -> None:
    with torch.device("meta"):
        layer = SubMConv3d(2048, 128)
    assert layer.conv.weight.shape == (128, 3, 3, 3, 2048)
