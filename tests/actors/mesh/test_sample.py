"""Points on a lattice over triangles."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from recast.actors import mesh_generator as sampling
from recast.actors.mesh_generator import sample
from recast.actors.mesh_gltf import Glow, MeshMaterial, Triangles, Wrap
from recast.geometry import se3
from support.mesh_files import HALVES, SQUARE, SQUARE_UV, box

WHITE = MeshMaterial(np.ones(4))


def turned(seed: int) -> np.ndarray:
    return se3.quat_to_matrix(np.random.default_rng(seed).normal(size=4))


def square(rotation: np.ndarray, material: MeshMaterial = WHITE) -> Triangles:
    corners = (SQUARE.astype(np.float64) @ rotation.T)[HALVES]
    return Triangles(corners, SQUARE_UV[HALVES].astype(np.float64), None, material)


@settings(max_examples=30, deadline=None)
@given(seed=st.integers(0, 10**6))
def test_points_lie_on_the_triangles_and_stand_for_their_area(seed: int) -> None:
    rotation = turned(seed)
    found, step = sample([square(rotation)], 0.02)
    assert step == 0.02
    back = found.points @ rotation
    assert np.abs(back[:, 2]).max() < 1e-9
    assert back[:, :2].min() > -1e-9 and back[:, :2].max() < 1 + 1e-9
    np.testing.assert_allclose(found.normals, np.tile(rotation[:, 2], (len(found), 1)), atol=1e-9)
    # A square is a point more or less along its edges, four metres of 2 cm.
    rim = 4 / 0.02 * found.spacing[0] ** 2
    assert float((found.spacing**2).sum()) == pytest.approx(1.0, abs=rim)


@settings(max_examples=30, deadline=None)
@given(seed=st.integers(0, 10**6))
def test_a_shared_edge_gives_each_point_once(seed: int) -> None:
    """The square in two triangles, and in a fan about any point of it, has the same points."""
    rotation = turned(seed)
    two, _ = sample([square(rotation)], 0.05)
    rng = np.random.default_rng(seed)
    middle = np.append(rng.uniform(0.1, 0.9, 2), 0.0)
    fan = [[SQUARE[i], SQUARE[(i + 1) % 4], middle] for i in range(4)]
    four, _ = sample([replace(square(rotation), corners=np.array(fan) @ rotation.T, uv=None)], 0.05)
    order = [np.lexsort(np.round(one.points, 9).T) for one in (two, four)]
    np.testing.assert_allclose(two.points[order[0]], four.points[order[1]], atol=1e-9)


def test_texels_smaller_than_the_lattice_are_averaged() -> None:
    """Black and white columns one pixel wide: their mean in linear light, no moiré."""
    columns = np.zeros((256, 256, 4), np.uint8)
    columns[:, ::2] = 255
    columns[..., 3] = 255
    found, _ = sample([square(turned(0), replace(WHITE, texture=columns))], 0.05)
    assert found.albedo.min() > 0.45
    assert found.albedo.max() < 0.55


def test_texels_larger_than_the_lattice_are_found_again() -> None:
    quarters = np.zeros((2, 2, 4), np.uint8)
    quarters[0, 1] = [255, 0, 0, 255]  # upper right, seen from +z
    quarters[1, 0] = [0, 0, 255, 255]
    quarters[..., 3] = 255
    found, _ = sample([square(np.eye(3), replace(WHITE, texture=quarters))], 0.02)
    x, y = found.points[:, 0], found.points[:, 1]
    at = np.argmin(np.hypot(x - 0.75, y - 0.75))
    np.testing.assert_allclose(found.albedo[at], [1, 0, 0], atol=0.05)
    at = np.argmin(np.hypot(x - 0.25, y - 0.25))
    np.testing.assert_allclose(found.albedo[at], [0, 0, 1], atol=0.05)


@pytest.mark.parametrize(
    ("wrap", "columns"),
    [("REPEAT", "rgrgrg"), ("MIRROR", "grrggr"), ("CLAMP", "rrrggg")],
)
def test_textures_go_on_beyond_their_edges(wrap: Wrap, columns: str) -> None:
    """Red left of green, at texture coordinates from -1 to 2 along the square's x."""
    halves = np.zeros((8, 8, 4), np.uint8)
    halves[:, :4, 0] = halves[:, 4:, 1] = halves[..., 3] = 255
    part = square(np.eye(3), replace(WHITE, texture=halves, wrap=(wrap, wrap)))
    assert part.uv is not None
    found, _ = sample([replace(part, uv=part.uv * 3 - 1)], 0.02)
    for i, name in enumerate(columns):
        near = np.abs(found.points[:, 0] - (i + 0.5) / 6) < 0.03
        expected = [1, 0, 0] if name == "r" else [0, 1, 0]
        np.testing.assert_allclose(found.albedo[near].mean(axis=0), expected, atol=0.05)


def test_what_emits_is_kept_apart_from_what_reflects() -> None:
    dark = np.full((2, 2, 4), [0, 255, 0, 255], np.uint8)
    glow = Glow(np.array([0.5, 0.25, 3.0]), dark, SQUARE_UV[HALVES].astype(np.float64))
    red = MeshMaterial(np.array([0.6, 0.0, 0.0, 1.0]), gloss=0.7)
    found, _ = sample([replace(square(np.eye(3), red), glow=glow)], 0.1)
    np.testing.assert_allclose(found.albedo, np.tile([0.6, 0, 0], (len(found), 1)))
    np.testing.assert_allclose(found.emission, np.tile([0, 0.25, 0], (len(found), 1)))
    unlit, _ = sample([square(np.eye(3), replace(red, lit=False))], 0.1)
    assert not unlit.albedo.any() and not unlit.gloss.any()
    np.testing.assert_allclose(unlit.emission, np.tile([0.6, 0, 0], (len(unlit), 1)))


@pytest.mark.parametrize(
    ("alpha", "value", "seen"),
    [
        ("OPAQUE", 0.3, 1.0),
        ("MASK", 0.3, None),
        ("MASK", 0.6, 1.0),
        ("BLEND", 0.3, 0.3),
        ("BLEND", 0.99, 1.0),
        ("BLEND", 0.01, None),
    ],
)
def test_alpha(alpha: str, value: float, seen: float | None) -> None:
    material = MeshMaterial(np.array([1.0, 1.0, 1.0, value]), alpha=alpha)  # type: ignore[arg-type]
    found, _ = sample([square(np.eye(3), material)], 0.1)
    assert (len(found) > 0) == (seen is not None)
    assert np.all(found.alpha == seen)


def test_vertex_colours_are_mixed() -> None:
    colours = np.zeros((2, 3, 4))
    colours[..., 0] = SQUARE[HALVES][..., 0]  # red grows along x
    colours[..., 3] = 1
    found, _ = sample([replace(square(np.eye(3)), colours=colours)], 0.02)
    np.testing.assert_allclose(found.albedo[:, 0], found.points[:, 0], atol=1e-9)


def test_what_has_no_area_has_no_points() -> None:
    line = np.array([[[0, 0, 0], [1, 1, 1], [2, 2, 2]], [[1, 1, 1]] * 3], np.float64)
    part = Triangles(line, None, None, WHITE)
    assert len(sample([part], 0.01)[0]) == 0
    both, _ = sample([part, square(turned(1))], 0.02)
    alone, _ = sample([square(turned(1))], 0.02)
    np.testing.assert_array_equal(both.points, alone.points)


def test_too_many_points_become_fewer(monkeypatch: pytest.MonkeyPatch) -> None:
    corners, faces = box([0, 0, 0], [4, 2, 1])
    part = Triangles(corners[faces].astype(np.float64), None, None, WHITE)
    monkeypatch.setattr(sampling, "MOST_POINTS", 2000)
    found, step = sample([part], 0.01)
    assert step == pytest.approx(np.sqrt(28 / 2000))
    assert 1800 < len(found) < 2200


def test_slivers_count_by_their_rows(monkeypatch: pytest.MonkeyPatch) -> None:
    """A thousand needles a metre long have 10^5 rows of a lattice of a centimetre, no points."""
    needle = np.array([[0, 0, 0], [1e-6, 0, 0], [0.5, 1, 0]], np.float64)
    part = Triangles(np.tile(needle, (1000, 1, 1)), None, None, WHITE)
    monkeypatch.setattr(sampling, "MOST_ROWS", 20_000)
    _, step = sample([part], 0.01)
    assert step == pytest.approx(1000 / 20_000)
