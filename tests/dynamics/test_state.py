"""Ego states from logs."""

import numpy as np
import pytest

from recast import dynamics
from recast.dynamics import state as ego
from recast.geometry import se2


def circle_log(speed=6.0, curvature=0.1, acceleration=0.0, count=31, dt=0.1):
    times = dt * np.arange(count)
    distance = speed * times + 0.5 * acceleration * times**2
    heading = distance * curvature
    poses = np.stack([np.sin(heading) / curvature, (1 - np.cos(heading)) / curvature, heading], -1)
    return np.rint(times * 1e6).astype(np.int64), se2.to_se3(poses)


@pytest.mark.parametrize("at_us", [0, 100_000, 1_500_000, 3_000_000])
def test_speed_acceleration_and_steering(at_us):
    times, poses = circle_log(acceleration=1.0)
    state = dynamics.initial_state(times, poses, at_us)
    speed = 6.0 + at_us / 1e6
    assert state[ego.VX] == pytest.approx(speed, abs=0.05)
    assert state[ego.AX] == pytest.approx(1.0, abs=0.1)
    assert state[ego.ANGULAR_VELOCITY] == pytest.approx(speed * 0.1, abs=0.05)
    assert state[ego.STEERING_ANGLE] == pytest.approx(np.arctan(3.089 * 0.1), abs=0.01)
    np.testing.assert_allclose(state[ego.POSE], se2.from_se3(poses)[times == at_us][0], atol=1e-9)


def test_standing_vehicle_has_straight_wheels():
    times = np.arange(0, 2_000_000, 100_000)
    wobble = np.zeros((20, 3))
    wobble[:, 2] = 0.01 * np.arange(20)
    state = dynamics.initial_state(times, se2.to_se3(wobble), 1_000_000)
    assert state[ego.STEERING_ANGLE] == 0 and state[ego.VX] == pytest.approx(0)


def test_heading_wrap_does_not_spin_the_wheels():
    times, poses = circle_log()
    turned = se2.to_se3([0.0, 0.0, np.pi - 0.9]) @ poses  # crosses pi at t = 1.5 s
    state = dynamics.initial_state(times, turned, 1_500_000)
    assert state[ego.ANGULAR_VELOCITY] == pytest.approx(0.6, abs=1e-6)


def test_reversing_gives_negative_speed():
    times, poses = circle_log()
    state = dynamics.initial_state(times, poses[::-1], 1_500_000)
    assert state[ego.VX] == pytest.approx(-6.0, abs=0.02)


def test_a_time_outside_the_log_is_refused():
    times, poses = circle_log()
    with pytest.raises(ValueError, match="outside"):
        dynamics.initial_state(times, poses, 3_000_001)


def test_too_short_a_log_is_refused():
    times, poses = circle_log(count=1)
    with pytest.raises(ValueError, match="less than"):
        dynamics.initial_state(times, poses, 0)


def test_column_names_match_indices():
    assert ego.COLUMNS[ego.STEERING_RATE] == "steering_rate"
    assert ego.COLUMNS[ego.ANGULAR_ACCELERATION] == "angular_acceleration"
    assert ego.SIZE == 11


def test_pacifica_dimensions():
    car = dynamics.PACIFICA
    assert car.length == pytest.approx(5.176)
    assert car.centre_offset == pytest.approx(1.461)
    with pytest.raises(ValueError, match="wheelbase"):
        dynamics.VehicleParameters(wheelbase=0.0)
