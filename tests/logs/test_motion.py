"""Undoing the motion of a turn, and lengthening trajectories a little."""

from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from recast.geometry import se3
from recast.logs import Trajectory
from recast.logs.motion import LONGEST_TABLE_US, compensate, distinct_times, distort, extended

TIMES = 100_000 * np.arange(5, dtype=np.int64)


@settings(max_examples=20, deadline=None)
@given(st.integers(0, 10_000), st.integers(0, 400_000))
def test_distort_undoes_compensate(seed: int, reference: int) -> None:
    rng = np.random.default_rng(seed)
    ego = Trajectory(TIMES, se3.exp(rng.normal(0, 0.5, (5, 6))))
    points, times = rng.normal(0, 30, (40, 3)), rng.integers(0, 400_001, 40)
    moved = compensate(points, times, ego, reference)
    np.testing.assert_allclose(distort(moved, times, ego, reference), points, atol=1e-9)


@pytest.mark.parametrize("span", [1, 2_000, LONGEST_TABLE_US, LONGEST_TABLE_US + 1, 10**15])
@pytest.mark.parametrize("count", [0, 1, 3_000])
def test_distinct_times_are_those_of_a_sort(span: int, count: int) -> None:
    times = 1_317_000_000_000_000 + np.random.default_rng(3).integers(0, span, count)
    times[:2] = [1_317_000_000_000_000, 1_317_000_000_000_000 + span - 1][:count]
    for found, sorted_out in zip(
        distinct_times(times), np.unique(times, return_inverse=True), strict=True
    ):
        assert found.dtype == sorted_out.dtype
        np.testing.assert_array_equal(found, sorted_out)


def test_a_fixed_point_measured_on_the_way_is_one_point() -> None:
    ego = Trajectory(TIMES, se3.exp(np.arange(5)[:, None] * np.array([1.0, 0, 0, 0, 0, 0.1])))
    fixed = np.array([[20.0, 3.0, 1.0]])
    times = np.array([0, 130_000, 222_000, 400_000])
    seen = np.concatenate([se3.apply(se3.inverse(ego.at(t)), fixed) for t in times])
    together = compensate(seen, times, ego, 200_000)
    expected = se3.apply(se3.inverse(ego.at(200_000)), fixed)
    np.testing.assert_allclose(together, np.repeat(expected, 4, axis=0), atol=1e-9)


def test_extension_keeps_the_motion_and_has_a_limit() -> None:
    twist = np.array([1.0, 0.1, 0.0, 0.0, 0.0, 0.05])
    ego = Trajectory(TIMES, se3.exp(np.arange(5)[:, None] * twist))
    longer = extended(ego, -50_000, 480_000)
    np.testing.assert_array_equal(longer.timestamps_us, [-50_000, *TIMES, 480_000])
    np.testing.assert_allclose(longer.poses[0], se3.exp(-0.5 * twist), atol=1e-12)
    np.testing.assert_allclose(longer.poses[-1], se3.exp(4.8 * twist), atol=1e-12)
    assert extended(ego, -(10**9), 10**9).timestamps_us[[0, -1]].tolist() == [-150_000, 550_000]
    np.testing.assert_array_equal(extended(ego, 10_000, 20_000).timestamps_us, TIMES)


def test_a_single_pose_is_held() -> None:
    alone = Trajectory(TIMES[:1], se3.exp(np.ones((1, 6))))
    longer = extended(alone, -40_000, 60_000)
    assert longer.covers(-40_000) and longer.covers(60_000)
    np.testing.assert_allclose(longer.at(50_000), alone.poses[0], atol=1e-12)
    with pytest.raises(ValueError, match="outside"):
        longer.at(60_001)
