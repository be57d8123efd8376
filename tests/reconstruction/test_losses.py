from __future__ import annotations

import math

import pytest
import torch

from recast.reconstruction.losses import depth_loss, sky_entropy, sky_loss, solid_loss


def test_depth_loss_is_relative_and_trimmed() -> None:
    alpha = torch.full((4, 10), 0.5)
    depth = alpha * 10.0  # expected depth 10 m everywhere
    pixels = torch.arange(40)
    measured = torch.full((40,), 8.0)
    measured[:2] = 1000.0  # two outliers of forty: the 5 % that are dropped
    assert depth_loss(depth, alpha, pixels, measured).item() == pytest.approx(0.25, abs=1e-6)
    nothing = depth_loss(depth, alpha, pixels[:0], measured[:0])
    assert nothing.item() == 0.0


def test_sky_loss_counts_sky_pixels_only() -> None:
    alpha = torch.zeros(2, 5, requires_grad=True)
    with torch.no_grad():
        alpha[0] = 1.0
    loss = sky_loss(alpha, torch.tensor([0, 1, 7]))
    assert loss.item() == pytest.approx(2 / 10)
    loss.backward()
    assert alpha.grad is not None
    assert alpha.grad.flatten().nonzero().flatten().tolist() == [0, 1, 7]


@pytest.mark.parametrize(
    ("error", "expected"), [("relative", 0.25), ("metric", 2.0), ("inverse", 1 / 8 - 1 / 10)]
)
def test_depth_errors(error: str, expected: float) -> None:
    alpha = torch.full((4, 10), 0.5)
    pixels, measured = torch.arange(40), torch.full((40,), 8.0)
    measured[0] = 1e6
    found = depth_loss(alpha * 10.0, alpha, pixels, measured, 0.9, error)
    assert found.item() == pytest.approx(expected, abs=1e-5)
    all_of_them = depth_loss(alpha * 10.0, alpha, pixels, measured, 1.0, error)
    assert all_of_them.item() != pytest.approx(expected, abs=1e-5)


def test_inverse_depth_is_finite_where_nothing_is_drawn() -> None:
    depth = torch.zeros(2, 2, requires_grad=True)
    loss = depth_loss(depth, torch.zeros(2, 2), torch.arange(4), torch.ones(4), 1.0, "inverse")
    loss.backward()
    assert depth.grad is not None and torch.isfinite(depth.grad).all()


def test_sky_entropy_pulls_sky_open_and_ground_shut() -> None:
    alpha = torch.tensor([[0.25, 0.5, 1.0], [0.5, 0.0, 0.5]], requires_grad=True)
    sky, ground = torch.tensor([0, 2]), torch.tensor([1, 4])
    loss = sky_entropy(alpha, sky, ground)
    by_hand = -(math.log(0.75) + math.log(1e-6) + math.log(0.5) + math.log(1e-6)) / 6
    assert loss.item() == pytest.approx(by_hand, rel=1e-2)  # 1 - 1e-6 has few digits in float32
    loss.backward()
    assert alpha.grad is not None
    assert alpha.grad[0, 0] > 0 and alpha.grad[0, 1] < 0 and (alpha.grad[1, [0, 2]] == 0).all()


def test_what_the_lidar_met_is_pulled_shut() -> None:
    alpha = torch.tensor([[0.5, 0.25], [1.0, 0.0]], requires_grad=True)
    loss = solid_loss(alpha, torch.tensor([0, 1, 2]))
    assert loss.item() == pytest.approx((math.log(2) + math.log(4)) / 4)
    loss.backward()
    assert alpha.grad is not None
    assert torch.allclose(alpha.grad, torch.tensor([[-0.5, -1.0], [-0.25, 0.0]]))
