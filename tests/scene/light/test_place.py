from __future__ import annotations

import dataclasses

import numpy as np
import pytest
import torch

from recast.scene.light.relight import LitSurface, PlaceLight, SceneLight
from recast.scene.light.sun import SUN_OVER_SKY
from recast.splats import Gaussians
from scene.light import made_up


@pytest.fixture(scope="module")
def half_shaded() -> SceneLight:
    return SceneLight.of(made_up.half_shaded())


def test_sun_and_shade_are_told_by_the_road(half_shaded: SceneLight) -> None:
    lit = half_shaded.place(made_up.pose(8.0), made_up.SIZE)
    shaded = half_shaded.place(made_up.pose(32.0), made_up.SIZE)
    assert lit.seen.all() and shaded.seen.all()
    assert lit.sun.min() > 0.9 * SUN_OVER_SKY and shaded.sun.max() < 0.1 * SUN_OVER_SKY
    assert lit.sky.min() == 1.0
    ratio = half_shaded.brightness(np.array([32.0, 0, 0])) / half_shaded.brightness(  # type: ignore[operator]
        np.array([8.0, 0, 0])
    )
    assert ratio == pytest.approx((made_up.SHADED / made_up.LIT) ** 2.2, rel=1e-3)


def test_a_vehicle_on_the_border_is_lit_at_one_end(half_shaded: SceneLight) -> None:
    away = half_shaded.place(made_up.pose(20.0), made_up.SIZE)
    towards = half_shaded.place(made_up.pose(20.0, heading=np.pi), made_up.SIZE)
    assert away.sun[0] > 0.9 * SUN_OVER_SKY and away.sun[-1] < 0.1 * SUN_OVER_SKY
    np.testing.assert_allclose(away.sun, towards.sun[::-1])


def test_where_no_road_was_seen_the_street_is_as_usual(half_shaded: SceneLight) -> None:
    beside = half_shaded.place(made_up.pose(8.0, 60.0), made_up.SIZE)
    assert not beside.seen.any()
    sky, sun = half_shaded.usual
    assert set(beside.sky) == {sky} and set(beside.sun) == {sun}
    assert 0.3 * SUN_OVER_SKY < sun < 0.7 * SUN_OVER_SKY  # half of the road is in the shade


def test_ground_below_or_above_the_vehicle_is_not_its_road(half_shaded: SceneLight) -> None:
    bridge = made_up.pose(8.0)
    bridge[2, 3] += 5.0
    assert not half_shaded.place(bridge, made_up.SIZE).seen.any()


def test_a_street_without_road_says_so() -> None:
    nothing = made_up.half_shaded().background.select(torch.zeros(0, dtype=torch.int64))
    light = SceneLight.of(made_up.street(nothing))
    assert light.sunlit is None
    assert "no road was seen" in light.explain() and "is unknown" in light.explain()
    place = light.place(made_up.pose(3.0), made_up.SIZE)
    np.testing.assert_array_equal(place.sun, [SUN_OVER_SKY] * 3)


def test_a_scene_without_vehicles_is_refused() -> None:
    empty = dataclasses.replace(made_up.half_shaded(), actors={})
    with pytest.raises(ValueError, match="no actor"):
        SceneLight.of(empty)


def test_light_on_a_surface_by_hand() -> None:
    """Sky 0.8, sun 1.5 at 30 degrees ahead of a vehicle that heads for it."""
    elevation = np.radians(30.0)
    light = made_up.light(made_up.sun_at(np.pi / 2, elevation))
    normals = torch.tensor([[0.0, 0.0, 1.0], [1.0, 0.0, 0.0], [-1.0, 0.0, 0.0]])
    surface = LitSurface.of(normals, torch.zeros(3, 3), made_up.SIZE)
    three = np.ones(3)
    place = PlaceLight(0.8 * three, 1.5 * three, three > 0)
    found = light.on(place, surface, made_up.pose(0.0, heading=np.pi / 2)[:3, :3])

    def cosine(c: float) -> float:
        return max(0.25 + 0.5 * c + 5 * (3 * c * c - 1) / 32, 0.0)

    level, upright = np.sin(elevation), np.cos(elevation)
    ground = 0.15 * (0.8 + 1.5 * cosine(level))
    beside = 0.3 * 0.2
    expected = [
        0.8 + 1.5 * cosine(level),
        0.5 * 0.8 + beside + 0.5 * ground + 1.5 * cosine(upright),
        0.5 * 0.8 + beside + 0.5 * ground + 1.5 * cosine(-upright),
    ]
    np.testing.assert_allclose(found.numpy(), expected, rtol=1e-5)


def test_light_between_stations_is_interpolated() -> None:
    light = made_up.light(made_up.sun_at(0.0, np.radians(50.0)))
    ahead = torch.tensor([-1.6, -0.8, 0.0, 0.8, 1.6])  # stations at 0.8 of the half length
    points = torch.stack([ahead, 0 * ahead, 0 * ahead], dim=-1)
    up = torch.tensor([0.0, 0.0, 1.0]).expand(5, 3)
    surface = LitSurface.of(up, points, made_up.SIZE)
    place = PlaceLight(np.array([0.2, 0.6, 1.0]), np.zeros(3), np.ones(3, bool))
    found = light.on(place, surface, np.eye(3))
    np.testing.assert_allclose(found.numpy(), [0.2, 0.4, 0.6, 0.8, 1.0], rtol=1e-5)


def test_grass_is_not_road() -> None:
    scene = made_up.half_shaded()
    green = scene.background.sh.clone()
    green[:, :, 1] += 1.0
    lawn = Gaussians(**{**vars(scene.background), "sh": green})
    assert SceneLight.of(made_up.street(lawn)).sunlit is None
