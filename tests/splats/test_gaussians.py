"""Harmonics turn with the Gaussians, moved Gaussians look the same from the moved camera."""

from __future__ import annotations

import math

import numpy as np
import pytest
import torch
from hypothesis import given, settings
from hypothesis import strategies as st

from recast.geometry import se3
from recast.splats import Gaussians, concatenate, morton_order, rasterize
from recast.splats.gaussians import (
    evaluate_harmonics,
    harmonic_basis,
    matrix_to_quat,
    quat_multiply,
    quat_to_matrix,
    rotate_harmonics,
)
from support.splat_scenes import HEIGHT, WIDTH, K, camera, random_gaussians

quaternions = st.lists(st.floats(-1, 1), min_size=4, max_size=4).filter(
    lambda q: math.hypot(*q) > 0.1
)


@given(quat=quaternions, seed=st.integers(0, 1000), degree=st.integers(0, 3))
@settings(max_examples=50, deadline=None)
def test_rotated_harmonics_seen_from_the_rotated_direction(
    quat: list[float], seed: int, degree: int
) -> None:
    generator = torch.Generator().manual_seed(seed)
    rotation = quat_to_matrix(torch.tensor(quat, dtype=torch.float64))
    coefficients = torch.randn(6, (degree + 1) ** 2, 3, generator=generator, dtype=torch.float64)
    directions = torch.randn(6, 3, generator=generator, dtype=torch.float64)
    directions = torch.nn.functional.normalize(directions, dim=-1)
    turned = evaluate_harmonics(rotate_harmonics(coefficients, rotation), directions @ rotation.T)
    assert torch.allclose(turned, evaluate_harmonics(coefficients, directions), atol=1e-12)


def test_harmonics_are_orthonormal() -> None:
    count = 20000
    index = torch.arange(count, dtype=torch.float64) + 0.5
    z = 1 - 2 * index / count
    azimuth = index * math.pi * (3 - 5**0.5)
    radius = (1 - z * z).sqrt()
    points = torch.stack([radius * azimuth.cos(), radius * azimuth.sin(), z], dim=-1)
    values = harmonic_basis(points, 3)
    gram = values.T @ values * (4 * math.pi / count)
    assert torch.allclose(gram, torch.eye(16, dtype=torch.float64), atol=1e-3)


def test_harmonics_of_unknown_degree_are_refused() -> None:
    with pytest.raises(ValueError, match="degree 4"):
        harmonic_basis(torch.zeros(1, 3), 4)


@given(quat=quaternions)
@settings(max_examples=50, deadline=None)
def test_quaternions_agree_with_geometry(quat: list[float]) -> None:
    matrix = quat_to_matrix(torch.tensor(quat, dtype=torch.float64))
    assert np.allclose(matrix.numpy(), se3.quat_to_matrix(quat), atol=1e-12)
    again = quat_to_matrix(matrix_to_quat(matrix))
    assert torch.allclose(again, matrix, atol=1e-9)
    twice = quat_multiply(matrix_to_quat(matrix), matrix_to_quat(matrix))
    assert torch.allclose(quat_to_matrix(twice), matrix @ matrix, atol=1e-9)


def pose_of(quat: list[float], translation: list[float]) -> torch.Tensor:
    pose = torch.eye(4, dtype=torch.float64)
    pose[:3, :3] = quat_to_matrix(torch.tensor(quat, dtype=torch.float64))
    pose[:3, 3] = torch.tensor(translation)
    return pose


def test_world_and_camera_moved_together_render_the_same() -> None:
    gaussians = random_gaussians("normal", count=200)
    world = pose_of([0.3, -0.8, 0.4, 0.2], [12.0, -7.0, 3.0])
    before = rasterize(gaussians, camera(), K, WIDTH, HEIGHT)
    after = rasterize(
        gaussians.transformed(world), camera() @ torch.linalg.inv(world), K, WIDTH, HEIGHT
    )
    assert torch.allclose(before.rgb, after.rgb, atol=2e-3)
    assert float((before.rgb - after.rgb).abs().mean()) < 2e-5


def test_scaled_world_and_camera_render_the_same_with_scaled_depth() -> None:
    gaussians = random_gaussians("normal", count=200)
    pose = camera()
    far = pose.clone()
    far[:3, 3] *= 3
    before = rasterize(gaussians, pose, K, WIDTH, HEIGHT)
    after = rasterize(
        gaussians.transformed(torch.eye(4), scale=3.0), far, K, WIDTH, HEIGHT, near=0.6
    )
    assert float((before.rgb - after.rgb).abs().mean()) < 2e-5
    assert float((3 * before.depth - after.depth).abs().mean()) < 2e-4


def test_transform_is_differentiable_in_gaussians_and_pose() -> None:
    gaussians = random_gaussians("normal", count=20)
    leaves = [v.double().requires_grad_() for v in vars(gaussians).values()]
    pose = pose_of([0.3, -0.8, 0.4, 0.2], [1.0, 2.0, 3.0]).requires_grad_()
    weights = torch.rand(20, 4 + 48 + 3, dtype=torch.float64)

    def total(pose: torch.Tensor) -> torch.Tensor:
        moved = Gaussians(*leaves).transformed(pose)
        rows = torch.cat([moved.means, moved.quats, moved.sh.flatten(1)], dim=1)
        return (rows * weights).sum()

    gradients = torch.autograd.grad(total(pose), [*leaves[:2], leaves[4], pose])
    assert all(bool(g.any()) for g in gradients)
    step = 1e-6
    # Along a rotation about z: off the group the pose means nothing.
    twist = torch.zeros(4, 4, dtype=torch.float64)
    twist[0, 1], twist[1, 0] = -1, 1
    direction = twist @ pose.detach()
    plus, minus = (
        total(torch.linalg.matrix_exp(s * step * twist) @ pose.detach()) for s in (1, -1)
    )
    slope = float((plus - minus).detach()) / (2 * step)
    assert float((gradients[-1] * direction).sum()) == pytest.approx(slope, rel=1e-5)


def test_transform_refuses_what_is_not_rigid() -> None:
    gaussians = random_gaussians("normal", count=2)
    mirror = torch.eye(4)
    mirror[0, 0] = -1
    for bad in (2 * torch.eye(4), mirror):
        with pytest.raises(ValueError, match="rigid"):
            gaussians.transformed(bad)
    with pytest.raises(ValueError, match="scale"):
        gaussians.transformed(torch.eye(4), scale=0.0)


def test_concatenate_pads_harmonics() -> None:
    low, high = random_gaussians("normal", 3, degree=0), random_gaussians("normal", 4, degree=2)
    both = concatenate([low, high])
    both.validate()
    assert len(both) == 7
    assert both.sh_degree == 2
    assert torch.equal(both.sh[:3, :1], low.sh)
    assert not both.sh[:3, 1:].any()
    assert torch.equal(both.select(torch.arange(3, 7)).sh, high.sh)
    with pytest.raises(ValueError, match="no Gaussians"):
        concatenate([])


def test_morton_order_brings_neighbours_together() -> None:
    generator = torch.Generator().manual_seed(0)
    means = torch.rand(4000, 3, generator=generator)
    order = morton_order(means)
    assert torch.equal(order.sort().values, torch.arange(4000))
    shuffled = (means[1:] - means[:-1]).norm(dim=1).mean()
    ordered = (means[order][1:] - means[order][:-1]).norm(dim=1).mean()
    assert float(ordered) < 0.2 * float(shuffled)
    assert len(morton_order(torch.zeros(0, 3))) == 0


def test_morton_order_of_the_cube_corners() -> None:
    corners = torch.tensor([[x, y, z] for z in (0.0, 1) for y in (0.0, 1) for x in (0.0, 1)])
    assert torch.equal(morton_order(corners), torch.arange(8))
    flipped = corners.flip(0)
    assert torch.equal(flipped[morton_order(flipped)], corners)
