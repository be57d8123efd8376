"""SE(2): group axioms, wrapping, agreement with SE(3)."""

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from recast.geometry import se2

from .strategies import planar_poses


def close(a, b, tolerance=1e-9):
    a, b = np.asarray(a), np.asarray(b)
    np.testing.assert_allclose(a[..., :2], b[..., :2], rtol=0, atol=tolerance)
    np.testing.assert_allclose(se2.wrap_angle(a[..., 2] - b[..., 2]), 0, rtol=0, atol=tolerance)


@given(planar_poses, planar_poses, planar_poses)
def test_group_axioms(a, b, c):
    identity = np.zeros(3)
    close(se2.compose(se2.compose(a, b), c), se2.compose(a, se2.compose(b, c)))
    close(se2.compose(a, identity), a)
    close(se2.compose(identity, a), a)
    close(se2.compose(a, se2.inverse(a)), identity)
    close(se2.compose(se2.inverse(a), a), identity)


@given(planar_poses, planar_poses)
def test_relative_undoes_compose(a, b):
    close(se2.relative(a, se2.compose(a, b)), b)
    close(se2.compose(a, se2.relative(a, b)), b)


@given(planar_poses, planar_poses, st.floats(-5, 5))
def test_agrees_with_se3(a, b, z):
    close(se2.from_se3(se2.to_se3(a, z) @ se2.to_se3(b)), se2.compose(a, b))
    assert se2.to_se3(a, z)[2, 3] == z


def test_batches():
    rng = np.random.default_rng(0)
    a, b = rng.normal(size=(4, 1, 3)), rng.normal(size=(5, 3))
    assert se2.compose(a, b).shape == (4, 5, 3)
    close(se2.compose(a, b)[2, 3], se2.compose(a[2, 0], b[3]))
    assert se2.to_se3(b, np.arange(5.0)).shape == (5, 4, 4)


@given(st.floats(-1e6, 1e6))
def test_wrapping(angle):
    wrapped = se2.wrap_angle(angle)
    assert -np.pi <= wrapped < np.pi
    assert se2.wrap_angle(wrapped) == wrapped
    turns = (angle - wrapped) / (2 * np.pi)
    assert turns == pytest.approx(round(turns), abs=1e-9)


@pytest.mark.parametrize(
    ("angle", "wanted"),
    [
        (np.pi, -np.pi),
        (-np.pi, -np.pi),
        (3 * np.pi, -np.pi),
        (np.nextafter(-np.pi, -4.0), -np.pi),  # the remainder rounds to a whole turn here
        (1e-300, 1e-300),
        (-1e-20, -1e-20),
    ],
)
def test_wrapping_at_the_seam_and_near_zero(angle, wanted):
    found = se2.wrap_angle(angle)
    assert -np.pi <= found < np.pi
    assert found == pytest.approx(wanted, abs=1e-15)
    if wanted != -np.pi:
        assert found == wanted
