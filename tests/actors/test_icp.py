from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from recast.actors.icp import FitSurface, IcpLimits, align, fit_of
from recast.geometry import se3


def vehicle(rng: np.random.Generator, count: int) -> FitSurface:
    """A closed car-like surface: a lower box with a cabin towards the rear."""
    points, normals = [], []
    for low, high in (
        ([-2.2, -0.9, -0.7], [2.2, 0.9, 0.1]),
        ([-2.0, -0.7, 0.1], [0.6, 0.7, 0.75]),
    ):
        low, high = np.array(low), np.array(high)
        for axis in range(3):
            for sign in (-1, 1):
                face = rng.uniform(low, high, (count, 3))
                face[:, axis] = high[axis] if sign > 0 else low[axis]
                points.append(face)
                normals.append(np.tile(sign * np.eye(3)[axis], (count, 1)))
    stacked = np.concatenate(points)
    return FitSurface(stacked, np.concatenate(normals), np.arange(len(stacked)))


SURFACE = vehicle(np.random.default_rng(0), 1500)


def seen_from(surface: FitSurface, eye: list[float]) -> np.ndarray:
    facing = np.sum(surface.normals * (np.array(eye) - surface.points), axis=1) > 0.1
    return surface.points[facing]


@settings(max_examples=12, deadline=None)
@given(
    scale=st.floats(0.92, 1.1),
    yaw=st.floats(-0.2, 0.2),
    shift=st.tuples(*[st.floats(-0.2, 0.2)] * 3),
    noise=st.integers(0, 10_000),
)
def test_recovers_a_known_move(
    scale: float, yaw: float, shift: tuple[float, float, float], noise: int
) -> None:
    rng = np.random.default_rng(noise)
    lidar = seen_from(vehicle(rng, 300), [-8.0, 5.0, 1.5])
    lidar = lidar + rng.normal(0, 0.01, lidar.shape)
    # the asset is the vehicle moved by the inverse of what ICP has to find
    rotation = se3.rotation_z(yaw)
    moved = FitSurface(
        (SURFACE.points - shift) @ rotation / scale, SURFACE.normals @ rotation, SURFACE.index
    )
    # nothing is known beforehand: the points alone must give all five numbers
    result = align(moved, lidar, IcpLimits(scale_deviation=1.0))
    assert result.scale == pytest.approx(scale, abs=0.015)
    assert result.yaw == pytest.approx(yaw, abs=0.015)
    np.testing.assert_allclose(result.apply(moved.points), SURFACE.points, atol=0.06)


def test_points_inside_and_far_outliers_do_not_pull() -> None:
    rng = np.random.default_rng(3)
    lidar = seen_from(SURFACE, [-8.0, 5.0, 1.5])[::5]
    seats = rng.uniform([-1.5, -0.5, 0.2], [0.2, 0.5, 0.6], (len(lidar) // 12, 3))
    result = align(SURFACE, np.concatenate([lidar, seats]))
    assert result.converged
    assert abs(result.scale - 1) < 0.01
    assert np.linalg.norm(result.translation) < 0.02


def test_stays_within_its_limits() -> None:
    lidar = seen_from(SURFACE, [-8.0, 5.0, 1.5])[::5]
    limits = IcpLimits(scale=(0.95, 1.05), yaw=0.05, shift=0.1)
    turned = FitSurface(
        SURFACE.points @ se3.rotation_z(0.3) / 1.3 + [0.8, 0, 0], SURFACE.normals, SURFACE.index
    )
    result = align(turned, lidar, limits)
    assert 0.95 <= result.scale <= 1.05
    assert abs(result.yaw) <= 0.05
    assert np.linalg.norm(result.translation) <= 0.1 + 1e-9


def test_the_floor_holds_the_wheels() -> None:
    lidar = seen_from(SURFACE, [-8.0, 5.0, 1.5])[::5] * 1.06 + [0.05, 0.0, 0.12]
    result = align(SURFACE, lidar, floor=-0.65)
    assert result.apply(SURFACE.points)[:, 2].min() == pytest.approx(-0.65, abs=1e-9)
    assert result.scale > 1.02
    free = align(SURFACE, lidar)
    assert free.apply(SURFACE.points)[:, 2].min() > -0.65


def test_what_the_points_do_not_tell_stays() -> None:
    """Only the rear is seen: its distance fixes x, nothing fixes the length."""
    rear = SURFACE.points[(SURFACE.points[:, 0] < -2.19)][::3] + np.array([-0.1, 0.0, 0.0])
    result = align(SURFACE, rear)
    assert abs(result.scale - 1) < 0.06
    assert result.apply(np.array([[-2.2, 0, 0]]))[0, 0] == pytest.approx(-2.3, abs=0.02)


def test_a_vehicle_that_came_out_too_flat_keeps_its_length() -> None:
    """The box knows the length; LiDAR of two sides must not stretch it to mend the height."""
    lidar = seen_from(SURFACE, [-8.0, 5.0, 1.5])[::5]
    flat = FitSurface(SURFACE.points * [1.0, 1.0, 0.85], SURFACE.normals, SURFACE.index)
    floor = float(SURFACE.points[:, 2].min())
    trusting = align(flat, lidar, IcpLimits(scale_deviation=1.0), floor=floor)
    result = align(flat, lidar, floor=floor)
    assert trusting.scale > 1.15
    assert abs(result.scale - 1) < 0.06


def test_fit_counts_points() -> None:
    grid = np.zeros((1, 3))
    fit = fit_of(grid, np.array([[0.05, 0, 0], [0.0, 0.2, 0], [0.0, 0.0, 0.08]]))
    assert fit.median == pytest.approx(0.08)
    assert fit.mean == pytest.approx(0.11)
    assert fit.inlier_share == pytest.approx(2 / 3)
