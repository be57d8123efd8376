"""Even ground as a sheet: what lies on it is put flat on it, what stands on it is left alone."""

from __future__ import annotations

import math

import numpy as np
import pytest
import torch
from hypothesis import given
from hypothesis import strategies as st

from recast.logs import GroundHeight
from recast.reconstruction.densify import GroundSheet
from recast.reconstruction.settings import OPTIM
from recast.splats import Gaussians
from recast.splats.gaussians import quat_to_matrix

TOLERANCE = 0.02


def slope(along_x: float, along_y: float) -> GroundHeight:
    """A plane through the origin, 8 m to all sides of it."""
    at = np.arange(-8.0, 8.01, 0.5)
    height = along_x * at[None, :] + along_y * at[:, None]
    return GroundHeight(np.array([-8.0, -8.0]), 0.5, height)


def scattered(n: int, seed: int, spread_m: float) -> Gaussians:
    chance = torch.Generator().manual_seed(seed)
    means = torch.rand(n, 3, generator=chance) * 12 - 6
    means[:, 2] = (torch.rand(n, generator=chance) * 2 - 1) * spread_m
    return Gaussians(
        means=means,
        quats=torch.randn(n, 4, generator=chance),
        log_scales=torch.randn(n, 3, generator=chance) - 3,
        logit_opacities=torch.zeros(n),
        sh=torch.zeros(n, 1, 3),
    )


def copied(gaussians: Gaussians) -> Gaussians:
    return gaussians.select(torch.arange(len(gaussians)))


def across(gaussians: Gaussians, normal: torch.Tensor) -> torch.Tensor:
    """Standard deviation (N,) along a direction (3,)."""
    axes = quat_to_matrix(gaussians.quats)
    return ((normal @ axes) * gaussians.log_scales.exp()).norm(dim=1)


@given(along_x=st.floats(-0.2, 0.2), along_y=st.floats(-0.2, 0.2), seed=st.integers(0, 1000))
def test_what_is_near_a_slope_ends_flat_on_it(along_x: float, along_y: float, seed: int) -> None:
    sheet = GroundSheet(slope(along_x, along_y), TOLERANCE)
    normal = torch.tensor([-along_x, -along_y, 1.0])
    gaussians = scattered(40, seed, 0.24)
    gaussians.means[:, 2] += gaussians.means[:, :2] @ torch.tensor([along_x, along_y])
    before = copied(gaussians)
    sheet.settle(gaussians)
    above = gaussians.means @ normal
    assert above.abs().max() <= TOLERANCE + 1e-5
    was_above = before.means @ normal
    assert torch.allclose(above, was_above.clamp(-TOLERANCE, TOLERANCE), atol=1e-5)
    assert (
        across(gaussians, normal / normal.norm()) <= OPTIM.ground_thickness_m * (1 + 1e-3)
    ).all()
    assert torch.equal(gaussians.means[:, :2], before.means[:, :2])
    wide, was_wide = gaussians.log_scales.sort().values, before.log_scales.sort().values
    assert torch.equal(wide[:, 1:], was_wide[:, 1:])


def test_settling_twice_is_settling_once() -> None:
    sheet = GroundSheet(slope(0.05, -0.03), TOLERANCE)
    once = scattered(100, 3, 0.2)
    sheet.settle(once)
    twice = copied(once)
    sheet.settle(twice)
    for name in ("means", "log_scales"):
        assert torch.allclose(getattr(once, name), getattr(twice, name), atol=1e-6)
    axes = (quat_to_matrix(once.quats), quat_to_matrix(twice.quats))
    assert torch.allclose(*axes, atol=1e-3)


def test_what_is_out_of_reach_stays_as_it_was() -> None:
    ground = slope(0.0, 0.0)
    ground.height[:, 20:] = math.nan  # x > 2 m is not even
    gaussians = scattered(200, 1, 1.0)
    gaussians.means[:20, 0] = 30.0  # beside the grid
    before = copied(gaussians)
    GroundSheet(ground, TOLERANCE).settle(gaussians)
    uneven = before.means[:, 0] > 1.5
    far = (before.means[:, 2].abs() > OPTIM.ground_reach_m) | uneven
    assert 20 < int(far.sum()) < 190
    for name in ("means", "quats", "log_scales"):
        assert torch.equal(getattr(gaussians, name)[far], getattr(before, name)[far])
    assert gaussians.means[~far, 2].abs().max() <= TOLERANCE + 1e-6


def test_an_axis_that_points_down_is_as_good_as_one_that_points_up() -> None:
    gaussians = Gaussians(
        means=torch.zeros(2, 3),
        quats=torch.tensor([[1.0, 0, 0, 0], [0.0, 1, 0, 0]]),  # the second upside down
        log_scales=torch.tensor([[0.1, 0.1, 0.001]] * 2).log(),
        logit_opacities=torch.zeros(2),
        sh=torch.zeros(2, 1, 3),
    )
    before = copied(gaussians)
    GroundSheet(slope(0.0, 0.0), TOLERANCE).settle(gaussians)
    assert torch.allclose(quat_to_matrix(gaussians.quats), quat_to_matrix(before.quats), atol=1e-6)


def test_heights_between_cells_are_bilinear() -> None:
    height = np.array([[0.0, 1.0], [2.0, 5.0]])
    sheet = GroundSheet(GroundHeight(np.zeros(2), 1.0, height), TOLERANCE)
    z, normal = sheet.surface(torch.tensor([[0.25, 0.5, 0.0], [1.5, 0.5, 0.0]]))
    assert z[0].item() == pytest.approx(0.75 * 1.0 + 0.25 * 3.0)
    expected = torch.tensor([-2.0, -2.5, 1.0])  # dz/dx = 2 at y = 0.5, dz/dy = 2.5 at x = 0.25
    assert torch.allclose(normal[0], expected / expected.norm())
    assert math.isnan(z[1].item())
