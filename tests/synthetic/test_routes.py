"""Paths along lanes, and the speed on them."""

from __future__ import annotations

import numpy as np
import pytest

from recast.logs import HdMap, Lane
from recast.synthetic.traffic import (
    LATERAL_LIMIT,
    RoutePath,
    SpeedProfile,
    beside,
    extended_route,
    random_route,
    speed_profile,
)
from support.small_street import small_street


def lane(name: str, points: np.ndarray) -> Lane:
    line = np.c_[points, np.zeros(len(points))]
    return Lane(name, line, line, line, points[:3])


def test_a_circle_has_its_curvature_and_tangent() -> None:
    angle = np.linspace(0.0, 1.5, 40)
    circle = 20.0 * np.stack([np.sin(angle), 1 - np.cos(angle)], axis=-1)
    path = RoutePath.along(HdMap({"a": lane("a", circle)}, ()), ["a"])
    middle = np.linspace(8.0, path.length - 8.0, 30)
    np.testing.assert_allclose(path.curvature(middle), 1 / 20, rtol=0.03)
    x, y = path.position(middle).T
    radius = np.hypot(x, y - 20.0)
    np.testing.assert_allclose(radius, 20.0, atol=0.08)  # rounding cuts a bend by sigma^2 / 2r
    np.testing.assert_allclose(path.heading(middle), np.arctan2(x, 20.0 - y), atol=0.01)


def test_both_axles_of_a_vehicle_are_on_the_path() -> None:
    angle = np.linspace(0.0, 1.5, 40)
    circle = 15.0 * np.stack([np.sin(angle), 1 - np.cos(angle)], axis=-1)
    path = RoutePath.along(HdMap({"a": lane("a", circle)}, ()), ["a"])
    pose = path.poses(10.0, wheelbase=6.0)
    axis = 3.0 * np.array([np.cos(pose[2]), np.sin(pose[2])])
    for axle in (pose[:2] - axis, pose[:2] + axis):
        assert np.abs(path.line.to_frenet(axle)[1]) < 0.05


def test_a_corner_is_rounded() -> None:
    corner = np.array([[0.0, 0.0], [30.0, 0.0], [55.0, 25.0]])
    path = RoutePath.along(HdMap({"a": lane("a", corner)}, ()), ["a"])
    s = np.linspace(1.0, path.length - 1.0, 400)
    step = np.abs(np.diff(path.heading(s)))
    assert step.max() < 0.1
    assert path.heading(1.0) == pytest.approx(0.0, abs=1e-6)
    assert path.heading(path.length - 1.0) == pytest.approx(np.pi / 4, abs=1e-6)


def test_routes_go_on_to_both_ends_of_the_road() -> None:
    street = small_street()
    lanes = street.map.lanes
    count = sum(key.startswith("f1") for key in lanes)
    assert extended_route(street.map, ["f1-02"]) == tuple(f"f1-{i:02d}" for i in range(count))
    rng = np.random.default_rng(0)
    assert random_route(street.map, "b1-04", 70.0, rng) == ("b1-04", "b1-03")
    assert beside(street.map, ["f2-01", "f2-02"], "left") == ("f1-01", "f1-02")
    assert beside(street.map, ["f1-01", "f1-02"], "left") is None


def test_bends_are_taken_slowly_and_braking_is_gentle() -> None:
    street = small_street(bend=2.4)  # 25 m radius
    path = RoutePath.along(street.map, street.ego_route)
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
