from __future__ import annotations

import torch

from recast.trellis.layers import absolute_positions, timestep_embedding
from support.trellis import assert_same, golden_tensors


def test_positions_equal_the_published_embedding() -> None:
    ops = golden_tensors("ops")
    for channels in (64, 768, 1024):
        assert_same(absolute_positions(ops["ape_pos"], channels), ops[f"ape{channels}"])


def test_positions_are_padded_with_zeros_on_the_right() -> None:
    embedded = absolute_positions(torch.tensor([[1, 2, 3], [60, 1, 9]]), 1024)
    assert embedded.dtype == torch.float32
    assert not embedded[:, 1020:].any()
    assert embedded[:, 1019].all()


def test_time_embedding_equals_the_published_one() -> None:
    ops = golden_tensors("ops")
    assert_same(timestep_embedding(ops["ts_t"], 256), ops["ts_emb256"])


def test_time_embedding_starts_with_cosines() -> None:
    assert torch.equal(timestep_embedding(torch.zeros(1), 6), torch.tensor([[1.0, 1, 1, 0, 0, 0]]))
