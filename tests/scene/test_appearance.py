from __future__ import annotations

import math

import numpy as np
import pytest
import torch

from recast.logs import Trajectory
from recast.scene.actor import Appearance, coloured, fourier_basis, share_of
from support.gaussian_clouds import part


@pytest.mark.parametrize("share", [0.0, 0.1, 0.73, 1.0])
def test_basis_is_that_of_the_paper(share: float) -> None:
    turn = 2 * math.pi * share
    expected = [1, math.sin(turn), math.cos(turn), math.sin(2 * turn), math.cos(2 * turn)]
    assert torch.allclose(fourier_basis(share, 5), torch.tensor(expected), atol=1e-6)


def test_shares_run_over_the_labels_and_end_with_them() -> None:
    times = np.array([1000, 2000, 5000], np.int64)
    trajectory = Trajectory(times, np.tile(np.eye(4), (3, 1, 1)))
    assert [share_of(trajectory, t) for t in (0, 1000, 2000, 5000, 9000)] == [0, 0, 0.25, 1, 1]
    still = Trajectory(times[:1], np.eye(4)[None])
    assert share_of(still, 1000) == 0


def test_only_the_constant_harmonic_changes_and_gradients_follow_the_basis() -> None:
    gaussians = part(6, 0)
    fourier = torch.randn(6, 4, 3, generator=torch.Generator().manual_seed(1)).requires_grad_()
    result = coloured(gaussians, fourier, 0.3)
    assert torch.equal(result.sh[:, 1:], gaussians.sh[:, 1:])
    result.sh.sum().backward()
    assert fourier.grad is not None
    expected = fourier_basis(0.3, 5)[1:, None].expand(4, 3)
    assert torch.allclose(fourier.grad, expected.expand(6, 4, 3))


def test_frozen_colours_go_on_to_any_other_time() -> None:
    raw = part(6, 0)
    fourier = torch.randn(6, 4, 3, generator=torch.Generator().manual_seed(1))
    appearance = Appearance(fourier, frozen_share=0.4)
    frozen = coloured(raw, fourier, 0.4)
    for share in (0.0, 0.4, 0.9):
        there = coloured(raw, fourier, share)
        assert torch.allclose(appearance.at(frozen, share).sh, there.sh, atol=1e-6)
    assert not torch.allclose(appearance.at(frozen, 0.9).sh, frozen.sh, atol=0.1)
