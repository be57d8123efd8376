"""Polylines."""

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from recast.geometry import Polyline, se2

from .strategies import planar_poses


def gentle_curve(curvature=0.02, count=60, step=1.0):
    heading = curvature * step * np.arange(count)
    return Polyline(np.cumsum(step * np.stack([np.cos(heading), np.sin(heading)], axis=-1), axis=0))


@given(st.floats(0.0, 1.0), st.floats(-5, 5), st.floats(-0.03, 0.03))
def test_frenet_round_trip(fraction, lateral, curvature):
    line = gentle_curve(curvature)
    s = fraction * line.length
    back_s, back_lateral = line.to_frenet(line.to_cartesian(s, lateral))
    # at a vertex the normals of two segments enclose a wedge: 5 m out it is 0.15 m wide
    assert back_s == pytest.approx(s, abs=0.16)
    assert back_lateral == pytest.approx(lateral, abs=3e-3)


@given(st.floats(0.0, 1.0))
def test_points_on_the_line_project_to_themselves(fraction):
    line = gentle_curve()
    s, lateral = line.to_frenet(line.position(fraction * line.length))
    assert s == pytest.approx(fraction * line.length, abs=1e-9)
    assert lateral == pytest.approx(0, abs=1e-9)


@given(planar_poses, st.tuples(st.floats(-20, 80), st.floats(-20, 80)))
def test_frenet_does_not_depend_on_the_frame(move, point):
    line = gentle_curve()

    def shift(xy):
        poses = np.concatenate([xy, np.zeros((*np.shape(xy)[:-1], 1))], axis=-1)
        return se2.compose(move, poses)[..., :2]

    moved = Polyline(shift(line.points)).to_frenet(shift(np.array(point)))
    distance = np.linalg.norm(moved[1] - np.array(line.to_frenet(point)[1]))
    assert distance < 1e-6 or abs(moved[1]) == pytest.approx(abs(line.to_frenet(point)[1]))


def test_shapes_follow_the_query():
    line = gentle_curve()
    s, lateral = line.to_frenet(np.zeros((4, 5, 2)))
    assert s.shape == lateral.shape == (4, 5)
    assert line.position(np.zeros((3, 2))).shape == (3, 2, 2)
    assert line.to_frenet([0.0, 0.0])[0].shape == ()


def test_left_is_positive():
    line = Polyline(np.array([[0.0, 0], [10, 0]]))
    np.testing.assert_allclose(line.to_frenet([[3.0, 2.0], [3.0, -2.0]]), [[3, 3], [2, -2]])
    np.testing.assert_allclose(line.to_cartesian(3.0, 2.0), [3, 2])


def test_beyond_the_ends_positions_go_straight_on_and_projections_stop():
    line = Polyline(np.array([[0.0, 0], [10, 0], [10, 10]]))
    np.testing.assert_allclose(line.position([-2.0, 23.0]), [[-2, 0], [10, 13]])
    np.testing.assert_allclose(line.heading([-2.0, 23.0]), [0, np.pi / 2])
    s, lateral = line.to_frenet([[-3.0, 4.0], [10.0, 15.0]])
    np.testing.assert_allclose(s, [0, 20])
    np.testing.assert_allclose(lateral, [5, 5])


@pytest.mark.parametrize("bend", np.radians([-170, -120, -60, 60, 120, 170]))
def test_the_outside_of_a_bend_is_one_side(bend):
    """Past 90 degrees, one segment alone would call part of the outside the inside."""
    corner = np.array([10.0, 0.0])
    line = Polyline(
        np.array([[0, 0], corner, corner + 10 * np.array([np.cos(bend), np.sin(bend)])])
    )
    outside = bend / 2 - np.sign(bend) * np.pi / 2  # against the bisector
    spread = (np.pi / 2 - 0.01) * 0.999 * abs(bend) / np.pi
    angles = outside + np.linspace(-spread, spread, 21)
    points = corner + 2 * np.stack([np.cos(angles), np.sin(angles)], axis=-1)
    s, lateral = line.to_frenet(points)
    np.testing.assert_allclose(s, 10)
    np.testing.assert_allclose(lateral, -2 * np.sign(bend))


def test_blocks_do_not_change_the_projection(monkeypatch):
    line, points = gentle_curve(), np.random.default_rng(0).uniform(-20, 60, (500, 2))
    whole = line.to_frenet(points)
    monkeypatch.setattr(se2, "_BLOCK", 1000)
    np.testing.assert_array_equal(line.to_frenet(points), whole)


def test_from_points_drops_repeats():
    line = Polyline.from_points([[0, 0, 7], [0, 0, 7], [1, 0, 7], [1.05, 0, 7], [2, 0, 7]], 0.1)
    np.testing.assert_array_equal(line.points, [[0, 0], [1, 0], [2, 0]])
    assert line.length == 2.0


@pytest.mark.parametrize(
    "points", [np.zeros((0, 2)), np.zeros((1, 2)), np.zeros((9, 2)), np.zeros((9, 3))]
)
def test_no_line_in_a_single_place(points):
    with pytest.raises(ValueError, match=r"Polyline\.points"):
        Polyline.from_points(points)


@pytest.mark.parametrize("points", [[[0.0, 0], [0, 0], [1, 0]], [[0.0, 0], [np.nan, 0]]])
def test_bad_points_are_refused(points):
    with pytest.raises(ValueError, match=r"Polyline\.points"):
        Polyline(np.array(points))
