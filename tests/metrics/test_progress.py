"""R_c in its two readings."""

import numpy as np
import pytest

from recast.metrics.driving import route_completion

ROUTE = np.stack([np.linspace(0, 100, 101), np.zeros(101)], axis=-1)


def zigzag(length=41):
    x = np.linspace(10, 50, length)
    return np.stack([x, 0.5 * (-1.0) ** np.arange(length)], axis=-1)


def test_straight_drive():
    result = route_completion(np.stack([np.linspace(10, 55, 10), np.zeros(10)], -1), ROUTE)
    assert result.route_length == pytest.approx(90)
    assert result.r_c.value == pytest.approx(0.5)
    assert result.r_c_projection.value == pytest.approx(0.5)
    assert result.r_c.reason == "45.0 m of 90.0 m"


def test_weaving_lengthens_the_path_but_not_the_projection():
    result = route_completion(zigzag(), ROUTE)
    assert result.r_c.value == pytest.approx(40 * np.sqrt(2) / 90)
    assert result.r_c_projection.value == pytest.approx(40 / 90)


def test_counting_stops_at_the_collision():
    result = route_completion(zigzag(), ROUTE, collision_step=10)
    assert result.r_c_projection.value == pytest.approx(10 / 90)
    assert "until the collision at step 10" in result.r_c.reason


def test_a_collision_at_the_start_leaves_nothing():
    assert route_completion(zigzag(), ROUTE, collision_step=0).r_c.value == 0.0


def test_never_above_one():
    far = np.stack([np.linspace(0, 300, 10), np.zeros(10)], axis=-1)
    result = route_completion(far, ROUTE)
    assert result.r_c.value == result.r_c_projection.value == 1.0
    assert result.r_c.reason is None


def test_reversing_is_no_advance():
    back = np.stack([np.linspace(50, 40, 10), np.zeros(10)], axis=-1)
    assert route_completion(back, ROUTE).r_c_projection.value == 0.0


@pytest.mark.parametrize("route", [ROUTE[:1], np.zeros((5, 2)), ROUTE[:6]])
def test_no_route_left_gives_no_value(route):
    result = route_completion(zigzag(), route)
    assert not result.r_c.valid and "logged route" in result.r_c.reason
