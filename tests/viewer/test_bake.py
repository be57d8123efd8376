"""Splats for a browser: colours, covariances and the sky, against known answers."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
import torch

from recast.scene.sky import SkyMap
from recast.viewer.splat_nodes import LARGEST_SIGMA, baked, mean_directions, sky_dome
from support.gaussian_clouds import grey_gaussians

_C1 = 0.4886025119029199


def test_a_constant_colour_stays_whatever_looks_at_it() -> None:
    gaussians = grey_gaussians(np.array([[0.0, 0.0, 0.0], [5.0, 1.0, 2.0]]), 0.1, colour=0.25)
    for eyes in (torch.zeros(0, 3), torch.tensor([[9.0, 9.0, 9.0]])):
        assert np.allclose(baked(gaussians, eyes).colours, 0.25, atol=1e-6)


def test_a_colour_of_degree_one_is_that_of_the_direction_it_is_seen_in() -> None:
    plain = grey_gaussians(np.zeros((1, 3)), 0.1)
    sh = torch.zeros(1, 4, 3)
    sh[0, 3, 0] = -0.2 / _C1  # red grows by 0.2 x
    gaussians = replace(plain, sh=sh)
    from_behind = baked(gaussians, torch.tensor([[-4.0, 0.0, 0.0]])).colours[0]
    from_ahead = baked(gaussians, torch.tensor([[4.0, 0.0, 0.0]])).colours[0]
    assert from_behind == pytest.approx([0.7, 0.5, 0.5], abs=1e-6)
    assert from_ahead == pytest.approx([0.3, 0.5, 0.5], abs=1e-6)


def test_near_eyes_decide_on_the_direction() -> None:
    eyes = torch.tensor([[0.0, -1.0, 0.0], [-100.0, 0.0, 0.0]])
    direction = mean_directions(torch.zeros(1, 3), eyes)[0]
    assert direction == pytest.approx(np.array([0.01, 1.0, 0.0]) / np.hypot(0.01, 1.0), abs=1e-6)


def test_opposite_eyes_leave_the_direction_of_one() -> None:
    eyes = torch.tensor([[-2.0, 0.0, 0.0], [2.0, 0.0, 0.0]])
    assert mean_directions(torch.zeros(1, 3), eyes)[0].tolist() == [1.0, 0.0, 0.0]


def test_the_covariance_turns_with_the_gaussian() -> None:
    half = float(np.sqrt(0.5))  # a quarter turn about z: the long axis points along y
    gaussians = replace(
        grey_gaussians(np.zeros((1, 3)), 1.0),
        quats=torch.tensor([[half, 0.0, 0.0, half]]),
        log_scales=torch.log(torch.tensor([[3.0, 1.0, 0.5]])),
    )
    found = baked(gaussians, torch.zeros(0, 3)).covariances[0]
    assert np.allclose(found, np.diag([1.0, 9.0, 0.25]), atol=1e-5)


def test_what_is_too_large_for_float16_is_cut() -> None:
    found = baked(grey_gaussians(np.zeros((1, 3)), 5000.0), torch.zeros(0, 3)).covariances
    assert found[0, 0, 0] == pytest.approx(LARGEST_SIGMA**2, rel=1e-5)
    assert np.isfinite(found.astype(np.float16)).all()


def test_opacity_is_the_sigmoid() -> None:
    gaussians = replace(grey_gaussians(np.zeros((1, 3)), 1.0), logit_opacities=torch.zeros(1))
    assert baked(gaussians, torch.zeros(0, 3)).opacities.tolist() == [[0.5]]


def test_the_sky_is_around_and_has_the_colour_of_its_direction() -> None:
    colours = torch.zeros(16, 32, 3)
    colours[:8, :, 2] = 1.0  # blue above, black below
    dome = sky_dome(SkyMap(colours), np.array([1.0, 2.0, 3.0]), radius=100.0, count=500)
    away = dome.centres - np.array([1.0, 2.0, 3.0])
    assert np.allclose(np.linalg.norm(away, axis=1), 100.0, rtol=1e-4)
    high = away[:, 2] > 20.0
    assert dome.colours[high, 2].min() > 0.99 and dome.colours[away[:, 2] < -20, 2].max() < 0.01
    flattest = np.linalg.eigvalsh(dome.covariances.astype(np.float64))[:, 0]
    assert np.allclose(flattest, 1.0, atol=1e-2)
