"""Tracking: what must hold for any plan."""

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from recast import dynamics
from recast.dynamics import state as ego
from recast.geometry import se2

DT = 0.1


def straight_plan(speed, count=40):
    times = DT * np.arange(count + 1)
    return np.stack([speed * times, 0 * times, 0 * times], axis=-1)


def arc_plan(speed, curvature, count=40):
    heading = speed * curvature * DT * np.arange(count + 1)
    return np.stack([np.sin(heading) / curvature, (1 - np.cos(heading)) / curvature, heading], -1)


@pytest.mark.parametrize("speed", [0.0, 0.5, 5.0, 20.0])
def test_constant_speed_fit_is_exact(speed):
    profile = dynamics.fit_profile(straight_plan(speed))
    np.testing.assert_allclose(profile.velocity, speed, atol=1e-9)
    np.testing.assert_allclose(profile.acceleration, 0, atol=1e-9)
    np.testing.assert_allclose(profile.curvature, 0, atol=1e-12)


def test_arc_curvature_is_found():
    profile = dynamics.fit_profile(arc_plan(8.0, 0.05))
    np.testing.assert_allclose(profile.curvature[1:], 0.05, rtol=2e-2)


def test_jerk_matrices_differ_as_described():
    """Accelerating at 1 m/s^2 is free of jerk; the reference's slip shrinks the acceleration."""
    times = DT * np.arange(41)
    poses = np.stack([5 * times + 0.5 * times * (times - DT), 0 * times, 0 * times], axis=-1)
    right = dynamics.fit_profile(poses).acceleration
    shrunk = dynamics.fit_profile(
        poses, weights=dynamics.ProfileWeights(jerk=1e-2, jerk_matrix="reference")
    ).acceleration
    np.testing.assert_allclose(right, 1.0, atol=1e-9)
    assert shrunk.mean() < 0.99


@pytest.mark.parametrize("preset", dynamics.PRESETS)
def test_straight_plan_is_followed(preset):
    start = dynamics.make_state([0.0, 0.0, 0.0], speed=8.0)
    states = dynamics.track(start, straight_plan(8.0), 40, dynamics.PRESETS[preset])
    assert states.shape == (41, 11)
    np.testing.assert_allclose(states[:, ego.POSE], straight_plan(8.0), atol=1e-9)


@pytest.mark.parametrize("preset", dynamics.PRESETS)
def test_arc_is_followed_within_half_a_metre(preset):
    plan = arc_plan(8.0, 0.04)
    start = dynamics.make_state(plan[0], speed=8.0, angular_velocity=0.32)
    states = dynamics.track(start, plan, 40, dynamics.PRESETS[preset])
    assert np.linalg.norm(states[:, :2] - plan[:, :2], axis=1).max() < 0.5


def test_lateral_offset_decays():
    start = dynamics.make_state([0.0, 0.5, 0.0], speed=8.0)
    states = dynamics.track(start, straight_plan(8.0), 40)
    assert abs(states[-1, ego.Y]) < 0.15


def test_stop_plan_stops():
    start = dynamics.make_state([0.0, 0.0, 0.0], speed=0.15)
    states = dynamics.track(start, straight_plan(0.0), 40)
    assert abs(states[-1, ego.VX]) < 0.05
    np.testing.assert_array_equal(states[:, ego.STEERING_RATE], 0)


def test_neuroncap_bounds_acceleration():
    start = dynamics.make_state([0.0, 0.0, 0.0], speed=15.0)
    states = dynamics.track(start, straight_plan(2.0), 10, dynamics.PRESETS["neuroncap"])
    assert states[1:, ego.AX].min() == -6.0


def test_batch_equals_single():
    plans = np.stack([straight_plan(4.0), arc_plan(6.0, 0.05), straight_plan(0.0)])
    starts = dynamics.make_state(np.zeros((3, 3)), speed=[5.0, 6.0, 0.1])
    together = dynamics.track(starts, plans, 5)
    for state, plan, wanted in zip(starts, plans, together, strict=True):
        np.testing.assert_allclose(dynamics.track(state, plan, 5), wanted, atol=1e-12)


@settings(max_examples=25, deadline=None)
@given(
    st.tuples(*[st.floats(-100, 100)] * 2, st.floats(-3, 3)),
    st.floats(0, 15),
    st.floats(-0.08, 0.08).filter(lambda k: abs(k) > 1e-3),
)
def test_tracking_does_not_depend_on_the_world_frame(move, speed, curvature):
    plan = arc_plan(max(speed, 0.5), curvature)
    start = dynamics.make_state(plan[0], speed=speed, acceleration=0.4)
    moved_start = start.copy()
    moved_start[ego.POSE] = se2.compose(move, start[ego.POSE])
    found = dynamics.track(moved_start, se2.compose(move, plan), 10)
    wanted = dynamics.track(start, plan, 10)
    back = se2.relative(move, found[:, ego.POSE])
    np.testing.assert_allclose(back[:, :2], wanted[:, :2], atol=1e-7)
    np.testing.assert_allclose(se2.wrap_angle(back[:, 2] - wanted[:, 2]), 0, atol=1e-8)
    np.testing.assert_allclose(found[:, 3:], wanted[:, 3:], atol=1e-6)


def test_plan_to_poses_starts_at_the_ego():
    poses = dynamics.plan_to_poses([3.0, 4.0, np.pi / 2], straight_plan(1.0)[1:])
    np.testing.assert_allclose(poses[0], [3.0, 4.0, np.pi / 2])
    np.testing.assert_allclose(poses[10], [3.0, 5.0, np.pi / 2])
    assert poses.shape == (41, 3)


def test_perfect_following_lands_on_the_waypoints():
    plan = arc_plan(8.0, 0.05)
    states = dynamics.follow_perfectly(dynamics.make_state(plan[0], 8.0), plan, 5)
    np.testing.assert_array_equal(states[:, ego.POSE], plan[:6])
    np.testing.assert_allclose(states[1:, ego.VX], 8.0, atol=0.01)
    np.testing.assert_allclose(states[1:, ego.ANGULAR_VELOCITY], 0.4, atol=1e-9)


@pytest.mark.parametrize("steps", [0, 41])
def test_impossible_step_counts_are_refused(steps):
    with pytest.raises(ValueError, match="steps"):
        dynamics.track(dynamics.make_state(np.zeros(3)), straight_plan(1.0), steps)


def test_a_plan_too_short_to_fit_is_refused():
    with pytest.raises(ValueError, match="fit_profile"):
        dynamics.fit_profile(np.zeros((2, 3)))
