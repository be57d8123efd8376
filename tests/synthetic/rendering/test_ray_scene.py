"""Rays meet what a brute-force search says they meet."""

from __future__ import annotations

import importlib

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from recast.core.errors import InputError
from recast.geometry import se3
from recast.synthetic.rendering import SKY, STREET, RayScene
from recast.synthetic.surface import Surface
from synthetic.rendering.shapes import box, brute_force_cast, nothing, plane, pose


def soup(rng: np.random.Generator, count: int, spread: float) -> Surface:
    centres = rng.uniform(-spread, spread, (count, 1, 3))
    triangles = centres + rng.normal(0, 0.4, (count, 3, 3))
    faces = np.arange(3 * count).reshape(-1, 3)
    return Surface.make(triangles.reshape(-1, 3), faces, rng.random((count, 3)), "matte")


def random_pose(rng: np.random.Generator) -> np.ndarray:
    return se3.exp(np.concatenate([rng.uniform(-3, 3, 3), rng.uniform(-2, 2, 3)]))


@settings(max_examples=25, deadline=None)
@given(seed=st.integers(0, 2**32 - 1))
def test_cast_agrees_with_every_ray_against_every_triangle(seed: int) -> None:
    rng = np.random.default_rng(seed)
    offset = np.array([300.0, -200.0, 0.0]) * (seed % 2)  # far from the origin, as streets are
    moved = se3.from_rotation_translation(np.eye(3), offset)
    street = soup(rng, 40, 4.0).transformed(moved)
    scene = RayScene(street, {name: soup(rng, 20, 1.0) for name in "bac"})
    poses = {name: moved @ random_pose(rng) for name in "ac"}
    origins = rng.uniform(-6, 6, (200, 3)) + offset
    directions = rng.normal(size=(200, 3))
    directions /= np.linalg.norm(directions, axis=1, keepdims=True)

    fast, slow = (
        scene.cast(origins, directions, poses),
        brute_force_cast(scene, origins, directions, poses),
    )

    agree = (fast.instance == slow.instance) & (fast.face == slow.face)
    assert agree.mean() > 0.98  # rays through an edge may go either way in float32
    hit = agree & (slow.instance != SKY)
    assert np.allclose(fast.distance[hit], slow.distance[hit], atol=2e-3)
    assert set(np.unique(fast.instance)) <= {0, 1, 3, SKY}
    assert np.allclose(fast.u[hit], slow.u[hit], atol=5e-3)
    assert np.allclose(fast.v[hit], slow.v[hit], atol=5e-3)


def test_barycentrics_of_a_vehicle_alone() -> None:
    rng = np.random.default_rng(0)
    scene = RayScene(nothing(), {"a": soup(rng, 40, 1.0)})
    directions = rng.normal(size=(400, 3))
    directions /= np.linalg.norm(directions, axis=1, keepdims=True)
    poses = {"a": random_pose(rng)}
    origins = poses["a"][:3, 3] - 5 * directions
    fast, slow = (
        scene.cast(origins, directions, poses),
        brute_force_cast(scene, origins, directions, poses),
    )
    hit = (fast.face >= 0) & (fast.face == slow.face)
    assert hit.sum() > 100
    assert np.allclose(fast.u[hit], slow.u[hit], atol=5e-3)
    assert np.allclose(fast.v[hit], slow.v[hit], atol=5e-3)


@settings(max_examples=15, deadline=None)
@given(seed=st.integers(0, 2**32 - 1))
def test_occluded_is_whether_cast_meets_anything(seed: int) -> None:
    rng = np.random.default_rng(seed)
    scene = RayScene(soup(rng, 30, 4.0), {"a": soup(rng, 20, 1.0), "b": soup(rng, 20, 1.0)})
    posed = scene.posed({"a": random_pose(rng), "b": random_pose(rng)})
    origins = rng.uniform(-6, 6, (300, 3)).astype(np.float32)
    directions = rng.normal(size=(300, 3)).astype(np.float32)
    directions /= np.linalg.norm(directions, axis=1, keepdims=True)
    met = posed.cast(origins, directions).instance != SKY
    assert np.array_equal(posed.occluded(origins, directions), met)


def test_instances_are_numbered_by_sorted_name() -> None:
    scene = RayScene(plane(), {"zebra": box(), "ant": box()})
    poses = {"zebra": pose(10, 0), "ant": pose(20, 8)}
    ahead = np.array([[1.0, 0, 0], [20, 8, -0.5], [0, 0, -1], [0, 0, 1]])
    ahead /= np.linalg.norm(ahead, axis=1, keepdims=True)
    hits = scene.cast([0, 0, 1.2], ahead, poses)
    assert list(hits.instance) == [2, 1, STREET, SKY]
    assert hits.distance[0] == pytest.approx(8.0, abs=1e-4)
    assert np.isinf(hits.distance[3]) and hits.face[3] == -1


def test_models_without_a_pose_are_absent() -> None:
    scene = RayScene(nothing(), {"car": box()})
    assert scene.cast([0, 0, 1], [[1.0, 0, 0]], {}).instance[0] == SKY
    assert scene.cast([0, 0, 1], [[1.0, 0, 0]], {"car": pose(9, 0)}).instance[0] == 1


def test_empty_everything() -> None:
    hits = RayScene(nothing(), {"ghost": nothing()}).cast(
        [0, 0, 1], [[1.0, 0, 0]], {"ghost": np.eye(4)}
    )
    assert hits.instance[0] == SKY


def test_unknown_name_is_refused() -> None:
    with pytest.raises(ValueError, match="ghost"):
        RayScene(plane(), {"car": box()}).posed({"ghost": np.eye(4)})


def test_missing_embreex_names_the_extra(monkeypatch: pytest.MonkeyPatch) -> None:
    def refuse(name: str) -> None:
        raise ImportError(name)

    monkeypatch.setattr(importlib, "import_module", refuse)
    with pytest.raises(InputError, match=r"embreex.*recast-sim\[synthetic\]"):
        RayScene(plane(), {})
