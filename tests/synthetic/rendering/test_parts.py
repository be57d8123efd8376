"""Textures, sky, filter, and tone curve, each by itself."""

from __future__ import annotations

import numpy as np
import pytest

from recast.geometry.colour import linear_to_srgb
from recast.synthetic.rendering import RayScene
from recast.synthetic.rendering.lighting import Light, LightFilter, SkyLight, sky_light
from recast.synthetic.rendering.rays import cosine_directions
from recast.synthetic.rendering.shading import WHITE_LEVEL, develop, filmic
from recast.synthetic.rendering.surface_points import (
    SurfacePoints,
    surface_coordinates,
    surface_points,
    textured,
)
from recast.synthetic.surface import MATERIALS
from synthetic.rendering.shapes import box, plane, pose, sky

TEXTURED = sorted({m.name for m in MATERIALS if m.texture != "none"})


def ground_points(material: str, height: float) -> SurfacePoints:
    """A square metre grid of points looked at from straight above."""
    posed = RayScene(plane((0.3, 0.3, 0.3), material), {}).posed({})
    x, y = np.meshgrid(np.linspace(3, 11, 120), np.linspace(-4, 4, 120))
    origins = np.stack([x, y, np.full_like(x, height)], -1).reshape(-1, 3).astype(np.float32)
    directions = np.tile(np.float32([0, 0, -1]), (len(origins), 1))
    return surface_points(posed, origins, directions, posed.cast(origins, directions))[1]


@pytest.mark.parametrize("material", TEXTURED)
def test_textures_vary_keep_the_mean_and_fade_with_distance(material: str) -> None:
    near = textured(ground_points(material, 1.5), 1e-3)
    far = textured(ground_points(material, 1.5), 0.5)  # pixels of 0.75 m
    assert near.std(axis=0).max() > 0.008
    assert np.allclose(near.mean(axis=0), 0.3, rtol=0.15)
    fine, coarse = near.std(axis=0).max(), far.std(axis=0).max()
    assert coarse < 0.75 * fine
    assert np.all(near >= 0) and np.all(near <= 0.95)


def test_surface_coordinates_are_metres_along_the_surface() -> None:
    rng = np.random.default_rng(0)
    normal = rng.normal(size=3)
    normal[2] = 0.3
    normal /= np.linalg.norm(normal)
    along = rng.normal(size=(50, 3))
    along -= (along @ normal)[:, None] * normal
    flat = np.tile(normal, (50, 1)).astype(np.float32)
    u, v = surface_coordinates(along.astype(np.float32), flat)
    distances = np.linalg.norm(along[:, None] - along[None], axis=-1)
    mapped = np.hypot(u[:, None] - u[None], v[:, None] - v[None])
    assert np.allclose(mapped, distances, atol=1e-4)


@pytest.mark.parametrize("clouds", [0.0, 0.5, 1.0])
def test_ambient_is_the_mean_over_the_hemisphere(clouds: float) -> None:
    light = sky_light(sky(clouds=clouds))
    rng = np.random.default_rng(0)
    up = np.tile(np.float32([0, 0, 1]), (40_000, 1))
    directions = cosine_directions(up, rng.random((40_000, 2), np.float32))
    assert np.allclose(light.radiance(directions).mean(axis=0), light.ambient, rtol=0.02)


def test_sky_is_smooth_across_the_seam_of_its_table() -> None:
    light = SkyLight(sky(clouds=0.0))
    turn = np.deg2rad([-0.01, 0.01])
    z = np.array([0.3, 0.3])
    level = np.sqrt(1 - z * z)
    directions = np.stack([level * np.cos(turn), level * np.sin(turn), z], 1).astype(np.float32)
    first, second = light.radiance(directions)
    assert np.allclose(first, second, rtol=1e-3)


def test_sky_is_brightest_round_the_sun_and_kept_between_calls() -> None:
    light = sky_light(sky(clouds=0.0))
    assert sky_light(sky(clouds=0.0)) is light
    rng = np.random.default_rng(0)
    directions = rng.normal(size=(500, 3)).astype(np.float32)
    directions /= np.linalg.norm(directions, axis=1, keepdims=True)
    sun = light.sun_direction.astype(np.float32)[None]
    assert light.background(sun).sum() > 5 * light.background(directions).sum(axis=1).max()
    assert np.all(light.radiance(directions) > 0)


def filter_of(points_at: tuple[int, int]) -> tuple[LightFilter, int, np.ndarray]:
    """A camera straight above a box on the ground; which points are the box's."""
    height, width = points_at
    posed = RayScene(plane(), {"box": box((4, 4, 2))}).posed({"box": pose(0, 0, 1)})
    x, y = np.meshgrid(np.linspace(-4, 4, width), np.linspace(-4, 4, height))
    origins = np.stack([x, y, np.full_like(x, 20)], -1).reshape(-1, 3).astype(np.float32)
    directions = np.tile(np.float32([0, 0, -1]), (len(origins), 1))
    pixels, points = surface_points(posed, origins, directions, posed.cast(origins, directions))
    return LightFilter(points, pixels, height, width), len(points), points.instance == 1


def test_filter_keeps_what_is_constant_and_removes_noise() -> None:
    light_filter, count, _ = filter_of((40, 60))
    constant = Light(np.full(count, 0.5, np.float32), np.full((count, 3), 0.25, np.float32))
    smooth = light_filter.smooth(constant)
    assert np.allclose(smooth.sun, 0.5, atol=1e-5) and np.allclose(smooth.sky, 0.25, atol=1e-5)
    rng = np.random.default_rng(0)
    noise = rng.random((count, 3), np.float32)
    assert light_filter.smooth(Light(noise[:, 0], noise)).sky.std() < 0.15 * noise.std()


def test_filter_does_not_cross_edges() -> None:
    light_filter, _, top = filter_of((40, 60))
    value = np.where(top, np.float32(1), np.float32(0))
    smooth = light_filter.smooth(Light(value, np.repeat(value[:, None], 3, axis=1)))
    assert top.any() and not top.all()
    assert smooth.sky[top].min() > 0.97 and smooth.sky[~top].max() < 0.03


def test_developed_levels_follow_the_curve() -> None:
    radiance = np.linspace(0, 40, 9000, dtype=np.float32)
    grey = develop(np.repeat(radiance[:, None], 3, axis=1), white=2.0, exposure=0.7)
    expected = 255 * linear_to_srgb(filmic(radiance * 0.7 * WHITE_LEVEL / 2.0))
    assert np.abs(grey[:, 0] - expected).max() <= 1.0
    assert np.all(np.diff(grey[:, 0].astype(int)) >= 0)
    assert grey[0, 0] == 0 and grey[-1, 0] == 255
