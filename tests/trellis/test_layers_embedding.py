from __future__ import annotations

import math

import pytest
import torch

from recast.trellis.layers import absolute_positions, timestep_embedding
from support.trellis import FLOAT32, assert_same, golden_tensors


def test_positions_equal_the_published_embedding() -> None:
    ops = golden_tensors("ops")
    for channels in (64, 768, 1024):
        assert_same(absolute_positions(ops["ape_pos"], channels), ops[f"ape{channels}"])


def test_positions_are_padded_with_zeros_on_the_right() -> None:
    embedded = absolute_positions(torch.tensor([[1, 2, 3], [60, 1, 9]]), 1024)
    assert embedded.dtype == torch.float32
    assert not embedded[:, 1020:].any()
    assert embedded[:, 1019].all()


def test_time_embedding_equals_the_published_one_as_far_as_its_float32_goes() -> None:
    """The published angles t exp(-x) are of float32: x is rounded three times, then its
    exponential (2 ulp), the product and the wave (4 ulp), each time by one half of an ulp.
    """
    ops = golden_tensors("ops")
    x = math.log(10000) * torch.arange(128, dtype=torch.float64) / 128
    angles = ops["ts_t"].double()[:, None] * torch.exp(-x)
    bound = FLOAT32 * (angles * (3 * x + 5) + 8)
    error = (timestep_embedding(ops["ts_t"], 256).double() - ops["ts_emb256"].double()).abs()
    assert bool((error <= bound.repeat(1, 2)).all())


@pytest.mark.parametrize("t", [0.0, 0.25, 1.0, 333.3, 999.9, 1000.0])
def test_time_embedding_is_exact_to_the_last_bit_of_float32(t: float) -> None:
    found = timestep_embedding(torch.tensor([t]), 256)[0].double()
    time = float(torch.tensor(t))
    angles = [time * 10000 ** (-i / 128) for i in range(128)]
    exact = [math.cos(a) for a in angles] + [math.sin(a) for a in angles]
    # An angle of 1000 in float64 is good to 1e-12.
    assert float((found - torch.tensor(exact, dtype=torch.float64)).abs().max()) <= FLOAT32 + 1e-12


def test_time_embedding_starts_with_cosines() -> None:
    assert torch.equal(timestep_embedding(torch.zeros(1), 6), torch.tensor([[1.0, 1, 1, 0, 0, 0]]))
