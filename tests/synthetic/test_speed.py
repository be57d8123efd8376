from __future__ import annotations

import numpy as np
import pytest

from recast.synthetic.routes import LATERAL_LIMIT, LanePath, SpeedProfile, speed_profile
from synthetic.small_street import small_street


def test_bends_are_taken_slowly_and_braking_is_gentle() -> None:
    street = small_street(bend=2.4)  # 25 m radius
    path = LanePath.along(street.map, street.ego_route)
    profile = speed_profile(path, 13.0, np.random.default_rng(0))
    times = np.arange(0.0, 15.0, 0.1)
    s = profile.drive(60.0, times)
    speed = np.gradient(s, times)
    lateral = speed**2 * np.abs(path.curvature(s))
    assert lateral.max() <= LATERAL_LIMIT
    assert lateral.max() > 1.0, "is not slower than need be"
    assert np.abs(np.gradient(speed, times)[2:-2]).max() < 1.6
    assert speed.max() > 10.0


def test_driving_is_the_same_however_it_is_asked_for() -> None:
    s = np.linspace(0.0, 100.0, 201)
    profile = SpeedProfile(s, 8.0 + 2.0 * np.sin(s / 9.0))
    at_four = float(profile.drive(10.0, 4.0))
    np.testing.assert_allclose(profile.drive(at_four, 3.0), profile.drive(10.0, 7.0), atol=1e-4)
    np.testing.assert_allclose(profile.drive(at_four, -4.0), 10.0, atol=1e-4)
    near = profile.drive(30.0, [-0.005, 0.005])
    assert np.diff(near)[0] / 0.01 == pytest.approx(float(profile.at(30.0)), rel=1e-3)


def test_beyond_the_road_the_speed_stays() -> None:
    profile = SpeedProfile(np.array([0.0, 10.0]), np.array([5.0, 5.0]))
    np.testing.assert_allclose(profile.drive(5.0, [-2.0, 0.0, 3.0]), [-5.0, 5.0, 20.0])
