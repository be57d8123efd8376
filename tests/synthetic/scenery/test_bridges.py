"""The bridge leaves the room that was asked for."""

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from recast.synthetic.scenery import bridge
from recast.synthetic.surface import Surface


def below(surface: Surface, x: np.ndarray, y: np.ndarray) -> np.ndarray:
    """Lowest height of any triangle over each point (N,), inf where there is none."""
    a, b, c = np.moveaxis(surface.vertices[surface.faces], 1, 0)
    d1, d2 = (b - a)[:, :2], (c - a)[:, :2]
    det = d1[:, 0] * d2[:, 1] - d1[:, 1] * d2[:, 0]
    usable = np.abs(det) > 1e-9
    a, b, c, d1, d2, det = (value[usable] for value in (a, b, c, d1, d2, det))
    to = np.stack([x, y], axis=1)[:, None] - a[:, :2]
    u = (to[..., 0] * d2[:, 1] - to[..., 1] * d2[:, 0]) / det
    v = (d1[:, 0] * to[..., 1] - d1[:, 1] * to[..., 0]) / det
    inside = (u >= -1e-9) & (v >= -1e-9) & (u + v <= 1 + 1e-9)
    z = a[:, 2] + u * (b - a)[:, 2] + v * (c - a)[:, 2]
    return np.where(inside, z, np.inf).min(axis=1)


@settings(max_examples=15, deadline=None)
@given(
    span=st.floats(6, 60), width=st.floats(4, 30), clearance=st.floats(3, 8), seed=st.integers(0, 9)
)
def test_clearance_everywhere_between_the_abutments(
    span: float, width: float, clearance: float, seed: int
) -> None:
    surface = bridge(np.random.default_rng(seed), span, width, clearance)
    inside = np.abs(surface.vertices[:, 1]) < span / 2 - 1e-6
    if inside.any():
        assert surface.vertices[inside, 2].min() >= clearance - 1e-9
    x, y = np.meshgrid(np.linspace(-width, width, 15), np.linspace(-0.49, 0.49, 15) * span)
    assert below(surface, x.ravel(), y.ravel()).min() >= clearance - 1e-9


def test_deck_covers_the_road_below() -> None:
    surface = bridge(np.random.default_rng(0), 20.0, 10.0, 5.0)
    x, y = np.meshgrid(np.linspace(-4.9, 4.9, 9), np.linspace(-9.9, 9.9, 9))
    assert np.all(np.isfinite(below(surface, x.ravel(), y.ravel())))


def test_only_piers_stand_between_the_abutments() -> None:
    surface = bridge(np.random.default_rng(0), 20.0, 10.0, 5.0, piers=(2.0,))
    points = surface.vertices[
        (np.abs(surface.vertices[:, 1]) < 9.99) & (surface.vertices[:, 2] < 4.99)
    ]
    assert len(points)
    assert np.abs(points[:, 1] - 2.0).max() <= 0.51


@pytest.mark.parametrize("approach", [10.0, 50.0])
def test_ramps_end_on_the_ground_where_they_should(approach: float) -> None:
    surface = bridge(np.random.default_rng(0), 20.0, 10.0, 5.0, approach=approach)
    low, high = surface.bounds()
    assert high[1] == pytest.approx(10 + approach) and low[1] == pytest.approx(-10 - approach)
    ends = surface.vertices[np.abs(surface.vertices[:, 1]) > 9.9 + approach]
    assert np.abs(ends[:, 2]).max() < 0.05
    assert high[0] <= 5.0 + 1.6 * (5.0 + 1.5)
