"""Closed bodies turn their outsides outwards."""

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from recast.synthetic.scenery.furniture import STROKES, text_quads
from recast.synthetic.scenery.trees import directions, icosphere
from recast.synthetic.surface import SceneryPanels, Surface, at, boxes, lathe, prism, tube

GREY = (0.5, 0.5, 0.5)


def volume(surface: Surface) -> float:
    """Signed volume; positive when faces look outwards, exact when the surface is closed."""
    a, b, c = np.moveaxis(surface.vertices[surface.faces], 1, 0)
    return float(np.einsum("ij,ij->i", a, np.cross(b, c)).sum() / 6)


size = st.floats(0.1, 10)


@settings(max_examples=30, deadline=None)
@given(size, size, size, st.floats(-50, 50))
def test_box_volume(x: float, y: float, z: float, shift: float) -> None:
    surface = boxes((shift, 2, 3), (shift + x, 2 + y, 3 + z), GREY, "matte")
    assert volume(surface) == pytest.approx(x * y * z, rel=1e-6)
    panels = SceneryPanels()
    panels.box((shift, 2, 3), (shift + x, 2 + y, 3 + z), GREY, "matte")
    assert volume(panels.surface()) == pytest.approx(x * y * z, rel=1e-6)


def test_prism_lathe_and_tube_volumes() -> None:
    square = [(0, 0), (2, 0), (2, 2), (0, 2)]
    assert volume(prism(square, 1, 4, GREY, "matte")) == pytest.approx(12.0)
    cone = lathe([(0.0, 0.0), (1.0, 0.0), (0.0, 3.0)], 400, GREY, "matte")
    assert volume(cone) == pytest.approx(np.pi, rel=1e-3)
    bar = tube([[0, 0, 0], [0, 3, 4]], 0.5, 400, GREY, "matte")
    assert volume(bar) == pytest.approx(5 * np.pi / 4, rel=1e-3)


def test_at_turns_then_moves() -> None:
    moved = at(boxes((0, 0, 0), (1, 2, 3), GREY, "matte"), 10, 20, 30, np.pi / 2)
    np.testing.assert_allclose(moved.bounds(), [[8, 20, 30], [10, 21, 33]], atol=1e-12)


@pytest.mark.parametrize("level", [0, 1, 2])
def test_icosphere_is_a_closed_sphere(level: int) -> None:
    vertices, faces = icosphere(level)
    assert len(faces) == 20 * 4**level
    assert len(vertices) - 1.5 * len(faces) + len(faces) == 2, "Euler's formula"
    np.testing.assert_allclose(np.linalg.norm(vertices, axis=1), 1.0)
    surface = Surface.make(vertices, faces, GREY, "matte")
    assert {0: 2.5, 1: 3.6, 2: 4.0}[level] < volume(surface) < 4 / 3 * np.pi


def test_directions_are_unit_and_spread() -> None:
    out = directions(np.random.default_rng(0), 200)
    np.testing.assert_allclose(np.linalg.norm(out, axis=1), 1.0)
    assert np.linalg.norm(out.mean(axis=0)) < 0.05


@pytest.mark.parametrize("character", STROKES)
def test_glyphs_are_as_tall_as_asked_and_wind_one_way(character: str) -> None:
    pieces = text_quads(character, 2.0)
    a, b, c, _ = np.moveaxis(pieces, 1, 0)
    turn = (b - a)[:, 0] * (c - b)[:, 1] - (b - a)[:, 1] * (c - b)[:, 0]
    assert np.all(turn > 0)
    assert np.abs(pieces[..., 1]).max() < 1.25


def test_text_is_centred() -> None:
    u = text_quads("88", 1.0)[..., 0]
    assert u.min() == pytest.approx(-u.max(), abs=1e-9)
