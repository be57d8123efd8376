from __future__ import annotations

import numpy as np
import pytest
import torch

from recast.actors.icp import bounds, outer_surface
from recast.splats import Gaussians, concatenate


def ball(count: int, radius: float, opacity: float, sigma: tuple[float, float, float]) -> Gaussians:
    rng = np.random.default_rng(count)
    points = rng.normal(size=(count, 3))
    points *= radius / np.linalg.norm(points, axis=1, keepdims=True)
    logit = float(np.log(opacity / (1 - opacity)))
    return Gaussians(
        torch.tensor(points, dtype=torch.float32),
        torch.tensor([[1.0, 0, 0, 0]]).repeat(count, 1),
        torch.log(torch.tensor([sigma])).repeat(count, 1),
        torch.full((count,), logit),
        torch.zeros(count, 1, 3),
    )


def test_interior_and_faint_gaussians_are_left_out() -> None:
    shell = ball(9000, 1.0, 0.9, (0.02, 0.02, 0.02))
    inside = ball(500, 0.5, 0.9, (0.02, 0.02, 0.02))
    haze = ball(500, 1.4, 0.1, (0.02, 0.02, 0.02))
    surface = outer_surface(concatenate([shell, inside, haze]))
    radius = np.linalg.norm(surface.points, axis=1)
    assert len(surface.points) > 8000
    assert np.mean(radius < 0.9) < 0.002
    assert radius.max() < 1.01


def test_normals_of_round_gaussians_come_from_neighbours() -> None:
    surface = outer_surface(ball(4000, 1.0, 0.9, (0.02, 0.02, 0.02)))
    assert np.median(np.abs(np.sum(surface.points * surface.normals, axis=1))) > 0.99


def test_normals_of_flat_gaussians_are_their_short_axis() -> None:
    surface = outer_surface(ball(4000, 1.0, 0.9, (0.02, 0.001, 0.02)))
    np.testing.assert_allclose(
        np.abs(surface.normals), np.tile([0, 1, 0], (len(surface.points), 1))
    )


def test_a_transparent_asset_is_refused() -> None:
    with pytest.raises(ValueError, match="at least 50"):
        outer_surface(ball(100, 1.0, 0.1, (0.02, 0.02, 0.02)))


def test_bounds_ignore_strays() -> None:
    points = np.concatenate([np.random.default_rng(0).uniform(-1, 1, (5000, 3)), [[50, 50, 50]]])
    low, high = bounds(points)
    assert np.all(np.abs(low + 1) < 0.02)
    assert np.all(np.abs(high - 1) < 0.02)
