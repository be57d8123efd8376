from __future__ import annotations

import dataclasses

import numpy as np
import pytest
import torch

from recast.cameras import PinholeCamera
from recast.geometry import se3
from recast.geometry.colour import GAMMA
from recast.scene import SceneActor, SceneRasterizer
from recast.scene.light import (
    ActorLight,
    CastShadow,
    LitSurface,
    SceneLight,
    SeenShadow,
    darkened,
    recorded_light,
)
from recast.scene.light.relight import COAT, Paint, PlaceLight, rounded
from recast.splats import Gaussians
from recast.splats.gaussians import C0
from scene.light import made_up

PEBBLES = 300


def pebbles() -> Gaussians:
    """A vehicle: round Gaussians all over a box."""
    generator = torch.Generator().manual_seed(0)
    half = torch.from_numpy(made_up.SIZE / 2).float()
    return Gaussians(
        means=half * (2 * torch.rand(PEBBLES, 3, generator=generator) - 1),
        quats=torch.tensor([[1.0, 0.0, 0.0, 0.0]]).repeat(PEBBLES, 1),
        log_scales=torch.full((PEBBLES, 3), -2.0),
        logit_opacities=torch.full((PEBBLES,), 4.0),
        sh=0.4 * torch.randn(PEBBLES, 4, 3, generator=generator),
    )


def surface_of(gaussians: Gaussians) -> LitSurface:
    normals = torch.nn.functional.normalize(gaussians.means, dim=1)
    return LitSurface.of(normals, gaussians.means, made_up.SIZE)


def actor_with_light(light: SceneLight, recorded_at: np.ndarray) -> SceneActor:
    gaussians = pebbles()
    surface = surface_of(gaussians)
    recorded = recorded_light(light, surface, made_up.SIZE, [recorded_at])
    trajectory = made_up.half_shaded().actors["7"].trajectory
    lighting = ActorLight(light, gaussians, surface, recorded, None)
    return SceneActor("7", gaussians, made_up.SIZE, trajectory, light=lighting)


@pytest.fixture(scope="module")
def half_shaded() -> SceneLight:
    return SceneLight.of(made_up.half_shaded())


def test_where_it_was_recorded_nothing_changes(half_shaded: SceneLight) -> None:
    pose = made_up.pose(7.93, 0.04, heading=0.3)
    actor = actor_with_light(half_shaded, pose)
    lit = actor.lit_at(pose)
    assert torch.equal(lit.gaussians.sh, actor.gaussians.sh)
    assert lit.light is None


def test_in_the_shade_it_is_darker_and_back_in_the_sun_brighter(half_shaded: SceneLight) -> None:
    sun, shade = made_up.pose(8.0), made_up.pose(32.0)
    there = actor_with_light(half_shaded, sun).lit_at(shade).gaussians
    back = actor_with_light(half_shaded, shade).lit_at(sun).gaussians
    before = pebbles()

    def bright(gaussians: Gaussians) -> float:
        return float((0.5 + C0 * gaussians.sh[:, 0]).mean())

    assert bright(there) < 0.85 * bright(before) < bright(before) < bright(back)
    # what was recorded in the sun is trusted more than what was recorded in the shade
    assert bright(before) / bright(there) > bright(back) / bright(before)


def test_the_ratio_is_that_of_the_light(half_shaded: SceneLight) -> None:
    """Old light 2, new light 1: paint falls by 2^-0.9, the mirrored sky stays."""
    gaussians = pebbles()
    display = torch.full((PEBBLES, 3), 0.6)
    grey = dataclasses.replace(gaussians, sh=((display - 0.5) / C0)[:, None])
    mirrored = COAT * 0.5
    lit = Paint(grey, mirrored).under(torch.full((PEBBLES,), 0.5))
    expected = ((0.6**GAMMA - mirrored) * 0.5**0.9 + mirrored) ** (1 / GAMMA)
    np.testing.assert_allclose((0.5 + C0 * lit.sh[:, 0]).numpy(), expected, rtol=1e-4)


@pytest.mark.parametrize("ratio", [0.0, 1e-6, 1e6, float("inf")])
def test_bounds(ratio: float) -> None:
    gaussians = pebbles()
    lit = Paint(gaussians, 0.02).under(torch.full((PEBBLES,), ratio))
    assert lit.fault() is None
    display = (0.5 + C0 * gaussians.sh[:, 0]).clamp(min=0)
    changed = (0.5 + C0 * lit.sh[:, 0]).clamp(min=0)
    low, high = 0.1 ** (0.9 / GAMMA), 6.0 ** (0.3 / GAMMA)
    assert (changed >= low * display - 1e-5).all() and (changed <= high * display + 1e-5).all()


def test_dark_glass_keeps_more_of_its_look_than_white_paint() -> None:
    gaussians = pebbles()
    display = torch.full((PEBBLES, 3), 0.15)
    display[1:] = 0.9
    coloured = dataclasses.replace(gaussians, sh=((display - 0.5) / C0)[:, None])
    lit = 0.5 + C0 * Paint(coloured, 0.02).under(torch.full((PEBBLES,), 0.2)).sh[:, 0]
    assert lit[0, 0] / 0.15 > 1.3 * lit[1, 0] / 0.9


def test_rounded_poses_are_rigid_and_near() -> None:
    pose = made_up.pose(3.217, -1.04, heading=0.7123)
    near = rounded(pose)
    np.testing.assert_allclose(near[:3, :3] @ near[:3, :3].T, np.eye(3), atol=1e-12)
    assert np.abs(near[:3, 3] - pose[:3, 3]).max() <= 0.05 + 1e-9
    assert abs(se3.yaw(near) - se3.yaw(pose)) < np.radians(1)
    np.testing.assert_array_equal(rounded(made_up.pose(3.222, -1.04, heading=0.7123)), near)


class Green:
    """Lights everything green, and counts."""

    shadow_room = 5

    def __init__(self) -> None:
        self.calls = 0

    def lit(self, actor: SceneActor, pose: np.ndarray) -> SceneActor:
        """Green wherever it stands, with a shadow of five Gaussians."""
        self.calls += 1
        sh = torch.zeros(len(actor.gaussians), 1, 3)
        sh[:, 0] = (torch.tensor([0.0, 1.0, 0.0]) - 0.5) / C0
        shadow = actor.gaussians.select(torch.arange(5))
        gaussians = dataclasses.replace(actor.gaussians, sh=sh)
        return dataclasses.replace(actor, gaussians=gaussians, shadow=shadow, light=None)


def test_the_rasterizer_lights_an_actor_once_for_each_place() -> None:
    green = Green()
    scene = made_up.half_shaded()
    actor = dataclasses.replace(scene.actors["7"], gaussians=pebbles(), light=green)
    rasterizer = SceneRasterizer(scene.with_actor(actor))
    camera = PinholeCamera(64, 48, 60.0, 60.0, 32.0, 24.0)
    looks = se3.from_rotation_translation(
        [[0.0, 0.0, 1.0], [-1.0, 0.0, 0.0], [0.0, -1.0, 0.0]], [0.0, 0.0, 1.0]
    )
    for turn in (0.0, 0.1):
        view = se3.inverse(looks @ se3.from_rotation_translation(se3.rotation_z(turn), [0, 0, 0]))
        image = rasterizer.render(camera, view, {"7": made_up.pose(8.0)})
        middle = image.rgb[22:28, 30:34].reshape(-1, 3).mean(axis=0)
        assert middle[1] > 0.8 and middle[[0, 2]].max() < 0.2
    assert green.calls == 1
    rasterizer.render(camera, view, {"7": made_up.pose(9.0)})
    assert green.calls == 2


def contact() -> Gaussians:
    """A black sheet under the box, as dark as 0.9 in its middle."""
    points = made_up.grid((-2, 2), (-1, 1), 0.14) - [0, 0, made_up.SIZE[2] / 2]
    sheet = made_up.sheet(points, np.array([0.0, 0.0, 1.0]), np.array([0.0]), 0.24)
    return dataclasses.replace(sheet, logit_opacities=torch.full((len(points),), -0.2))


def box_surface() -> np.ndarray:
    """Points (N, 3) 10 cm apart on the sides and the roof of the box, actor frame."""
    half = made_up.SIZE / 2
    x, y, z = (np.linspace(-h, h, int(20 * h) + 1) for h in half)
    every = np.stack(np.meshgrid(x, y, z, indexing="ij"), axis=-1).reshape(-1, 3)
    outer = np.any(np.isclose(np.abs(every), half)[:, :2], axis=1) | np.isclose(
        every[:, 2], half[2]
    )
    chosen: np.ndarray = every[outer]
    return chosen


@pytest.mark.parametrize("heading", [0.0, 1.3])
@pytest.mark.parametrize("azimuth", [90.0, -150.0])
def test_the_shadow_lies_on_the_side_away_from_the_sun(azimuth: float, heading: float) -> None:
    elevation, blur = np.radians(40.0), 0.6  # three deviations of the penumbra, metres
    light = made_up.light(made_up.sun_at(np.radians(azimuth), elevation))
    shadow = CastShadow(box_surface(), contact(), made_up.SIZE)
    three = np.ones(3)
    sheet = shadow.sheet(light, PlaceLight(three, 2 * three, three > 0), heading)
    sheet.validate()
    assert len(sheet) <= shadow.room
    local = sheet.means[:, :2].numpy().astype(np.float64)
    beyond = np.any(np.abs(local) > made_up.SIZE[:2] / 2 + blur, axis=1)
    relative = np.radians(azimuth) - heading
    away = -np.array([np.cos(relative), np.sin(relative)])
    corners = np.array([[1, 1], [1, -1], [-1, 1], [-1, -1]]) * made_up.SIZE[:2] / 2
    length = made_up.SIZE[2] / np.tan(elevation)
    # The roof is moved; between two of the directions, 15 degrees apart, to both places.
    side = np.array([-away[1], away[0]])
    spread = length * np.sin(np.radians(15.0)) + blur
    assert (np.abs(local[beyond] @ side) < np.abs(corners @ side).max() + spread).all()
    assert (local[beyond] @ away > (corners @ away).min() - 1e-9).all()
    farthest = float((local @ away).max())
    assert abs(farthest - (corners @ away).max() - length) < blur
    assert (local[beyond] @ away).mean() > 0.5 * length


def test_without_sun_the_shadow_is_that_of_the_sky_that_the_vehicle_hides() -> None:
    light = made_up.light(made_up.sun_at(0.0, 0.7))
    shadow = CastShadow(pebbles().means.numpy().astype(np.float64), contact(), made_up.SIZE)
    three = np.ones(3)
    sheet = shadow.sheet(light, PlaceLight(three, 0 * three, three > 0), 0.0)

    def dark(of: Gaussians) -> float:
        """Opacity that a sheet has in its middle, its Gaussians one above the other."""
        near = of.means[:, :2].norm(dim=1) < 0.6
        distance = of.means[near, :2].square().sum(1)
        alpha = torch.sigmoid(of.logit_opacities[near])
        width = of.log_scales[near, 0].exp().square()
        return 1 - float((1 - alpha * torch.exp(-distance / (2 * width))).prod())

    shown = 1 - (1 - dark(contact())) ** (1 / GAMMA)
    assert dark(sheet) == pytest.approx(shown, abs=0.05)


def test_a_seen_shadow_holds_for_its_heading_and_light() -> None:
    three = np.ones(3)
    sunny, shaded = (PlaceLight(three, sun * three, three > 0) for sun in (2.0, 0.0))
    seen = SeenShadow(contact(), np.array([np.pi - 0.05, 0.1]), 2.0)
    assert seen.share(sunny, 0.1) == pytest.approx(1.0)
    assert seen.share(sunny, -np.pi - 0.05) == pytest.approx(1.0)  # the same, once around
    assert 0.4 < seen.share(sunny, 0.1 + np.radians(15.0)) < 0.6
    assert seen.share(sunny, 0.1 + np.radians(35.0)) == 0.0
    assert seen.share(shaded, 0.1) == pytest.approx(1 / 3)


def test_a_seen_shadow_takes_the_place_of_the_cast_one(half_shaded: SceneLight) -> None:
    pose = made_up.pose(8.0, heading=0.3)
    actor = actor_with_light(half_shaded, pose)
    assert isinstance(actor.light, ActorLight)
    cast = CastShadow(box_surface(), contact(), made_up.SIZE)
    sun = float(half_shaded.place(rounded(pose), made_up.SIZE).sun.mean())
    seen = SeenShadow(darkened(contact(), 0.5), np.array([0.3]), sun)
    light = ActorLight(
        half_shaded, actor.gaussians, actor.light.surface, actor.light.recorded, cast, seen
    )
    lit = dataclasses.replace(actor, light=light)
    there = lit.lit_at(pose).shadow
    assert there is not None and len(there) <= light.shadow_room
    opacity, count = torch.sigmoid(there.logit_opacities), len(seen.sheet)
    assert opacity[:-count].max() < 0.05  # of the cast one, hardly anything is left
    wanted = torch.sigmoid(seen.sheet.logit_opacities)
    torch.testing.assert_close(opacity[-count:], wanted, atol=0.02, rtol=0)
    turned = rounded(made_up.pose(8.0, heading=1.3))
    alone, place = lit.lit_at(turned).shadow, half_shaded.place(turned, made_up.SIZE)
    assert alone is not None
    assert torch.equal(alone.means, cast.sheet(half_shaded, place, float(se3.yaw(turned))).means)
