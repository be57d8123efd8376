from __future__ import annotations

import numpy as np
import pytest
import torch

from recast.reconstruction.points import (
    PointCloud,
    concatenate,
    gaussians_from_points,
    neighbour_distance,
    voxel_downsample,
)
from recast.splats.gaussians import C0


def cloud_of(points: np.ndarray, distances: np.ndarray | None = None) -> PointCloud:
    n = len(points)
    colours = np.linspace(0, 1, 3 * n, dtype=np.float32).reshape(n, 3)
    far = np.ones(n, np.float32) if distances is None else distances.astype(np.float32)
    return PointCloud(points.astype(np.float32), colours, far)


def test_a_voxel_keeps_the_point_seen_from_nearest() -> None:
    points = np.array([[0.1, 0.1, 0.1], [0.2, 0.3, 0.1], [-0.1, 0.1, 0.1], [5.0, 5.0, 5.0]])
    thin = voxel_downsample(cloud_of(points, np.array([9.0, 4.0, 7.0, 1.0])), 0.5)
    kept = {tuple(np.round(p, 3)) for p in thin.points.tolist()}
    assert kept == {(0.2, 0.3, 0.1), (-0.1, 0.1, 0.1), (5.0, 5.0, 5.0)}
    row = np.flatnonzero(np.isclose(thin.points[:, 1], 0.3))[0]
    assert np.allclose(thin.colours[row], cloud_of(points).colours[1])


def test_no_points_is_no_error() -> None:
    assert len(voxel_downsample(PointCloud.empty(), 0.2)) == 0
    assert len(concatenate([])) == 0
    assert len(gaussians_from_points(PointCloud.empty(), 1)) == 0


def test_neighbour_distance_on_a_grid() -> None:
    axis = np.arange(5) * 0.2
    grid = np.stack(np.meshgrid(axis, axis, axis), -1).reshape(-1, 3).astype(np.float32)
    assert np.allclose(neighbour_distance(grid), 0.2, atol=1e-6)


def test_gaussians_have_the_points_colours_and_sizes() -> None:
    rng = np.random.default_rng(0)
    cloud = cloud_of(rng.random((50, 3)))
    gaussians = gaussians_from_points(cloud, 1)
    gaussians.validate()
    order = [int(np.abs(cloud.points - m).sum(1).argmin()) for m in gaussians.means.numpy()]
    assert sorted(order) == list(range(50))
    colours = gaussians.sh[:, 0].numpy() * C0 + 0.5
    assert np.allclose(colours, cloud.colours[order], atol=1e-6)
    assert (gaussians.sh[:, 1:] == 0).all()
    sigma = 0.7 * neighbour_distance(cloud.points)[order]
    assert np.allclose(gaussians.log_scales.exp().numpy(), sigma[:, None], rtol=1e-5)
    assert torch.sigmoid(gaussians.logit_opacities)[0].item() == pytest.approx(0.3)
