from __future__ import annotations

from dataclasses import replace

import cv2
import numpy as np
import pytest

from recast.actors import Observation
from recast.actors.template.body import TemplateBody
from recast.actors.template.cloud import SurfaceCloud, build_cloud
from recast.actors.template.design import STYLES
from recast.actors.template.lighting import (
    Daylight,
    estimate_light,
    estimate_rims,
    estimate_windows,
    road_level,
    road_light,
    road_tint,
    shade,
)
from recast.actors.template.proportions import TemplatePlacement
from recast.actors.template.texture import SurfaceView, view_surface
from recast.geometry.colour import gamma_to_linear, linear_to_gamma
from support import made_up_actors as made_up

PAINTS = {"white": 0.72, "silver": 0.42, "black": 0.012}


@pytest.fixture(scope="module")
def cloud() -> SurfaceCloud:
    return build_cloud(TemplateBody(made_up.SIZE, STYLES["estate"]), 0.05, np.random.default_rng(0))


def photographed(
    cloud: SurfaceCloud,
    paint: float | np.ndarray,
    light: Daylight,
    rims: float = 1.0,
    windows: float = 1.0,
) -> SurfaceView:
    """The car as a camera behind it on the left sees it, with the noise of an image."""
    eye = np.array([-9.0, 4.0, 1.8])
    views = eye - cloud.points
    views /= np.linalg.norm(views, axis=1, keepdims=True)
    factor = 1 - cloud.glass * (1 - windows)
    albedo = cloud.painted(np.broadcast_to(paint, 3)) * (factor - cloud.rim * (1 - rims))[:, None]
    heights = cloud.points[:, 2]
    colour = shade(albedo, cloud.gloss * factor, cloud.normals, heights, views, light)
    colour += np.random.default_rng(1).normal(0.0, 0.01, colour.shape)
    facing = np.sum(cloud.normals * views, axis=1)
    sharpness = np.full(len(facing), 40.0)
    return SurfaceView(np.clip(colour, 0, 1), (facing > 0.3).astype(float), views, sharpness)


def under(observation: Observation, level: float) -> Observation:
    """The street around the car in another light."""
    rgba = observation.rgba.copy()
    linear = level * gamma_to_linear(rgba[..., :3] / 255)
    rgba[..., :3] = np.round(255 * linear_to_gamma(linear))
    return replace(observation, rgba=rgba)


@pytest.mark.parametrize("name", PAINTS)
@pytest.mark.parametrize("level", [0.35, 1.0])
def test_unseen_parts_continue_the_brightness(
    cloud: SurfaceCloud, observation: Observation, name: str, level: float
) -> None:
    """In the shade and in daylight the flank that nobody saw is as bright as it was."""
    true = Daylight(level, level)
    seen = photographed(cloud, PAINTS[name], true)
    light, paint = estimate_light(cloud, [seen], under(observation, level))
    unseen = (cloud.paint > 0.9) & (cloud.normals[:, 1] < -0.8)
    views = np.array([[0.3, -0.95, 0.1]]) / np.linalg.norm([0.3, -0.95, 0.1])
    args = cloud.gloss[unseen], cloud.normals[unseen], cloud.points[unseen, 2], views
    count = int(unseen.sum())
    drawn = shade(np.tile(paint, (count, 1)), *args, light)
    wanted = shade(np.full((count, 3), PAINTS[name]), *args, true)
    assert np.abs(drawn - wanted).mean() < 0.04


def test_white_in_the_shade_is_not_grey(cloud: SurfaceCloud, observation: Observation) -> None:
    dim = Daylight(0.4, 0.4)
    seen = photographed(cloud, PAINTS["white"], dim)
    light, paint = estimate_light(cloud, [seen], under(observation, 0.4))
    assert light.level < 0.75
    assert linear_to_gamma(paint).min() > 0.68


@pytest.mark.parametrize("clouds", [0.0, 1.0])
@pytest.mark.parametrize(
    "srgb", [(0.25, 0.25, 0.27), (0.27, 0.25, 0.23), (0.08, 0.08, 0.09), (0.5, 0.1, 0.1)]
)
def test_paint_and_sky_are_told_apart(
    cloud: SurfaceCloud, observation: Observation, clouds: float, srgb: tuple[float, float, float]
) -> None:
    """A grey car under clouds does not turn brown, nor a brown one under a blue sky grey."""
    paint = gamma_to_linear(np.array(srgb))
    seen = photographed(cloud, paint, Daylight(clouds=clouds))
    light, found = estimate_light(cloud, [seen], observation)
    assert abs(light.clouds - clouds) < 0.35
    pair = np.array([[linear_to_gamma(found), srgb]], np.float32)
    lab = cv2.cvtColor(pair, cv2.COLOR_RGB2LAB)[0]
    assert np.linalg.norm(lab[0] - lab[1]) < 5.0


def test_shading_that_the_model_lacks_does_not_bleach_a_coloured_paint(
    cloud: SurfaceCloud, observation: Observation
) -> None:
    """Panels in a wrong shade tell nothing of the hue: it is the paint's own all over them."""
    srgb = np.array([0.55, 0.2, 0.12])
    seen = photographed(cloud, gamma_to_linear(srgb), Daylight(mirror=0.5, clouds=1.0))
    flank = np.abs(cloud.normals[:, 1]) > 0.8
    shaded = gamma_to_linear(seen.colour) * np.where(flank, 1.5, 0.7)[:, None]
    _, found = estimate_light(cloud, [replace(seen, colour=linear_to_gamma(shaded))], observation)
    found /= found.mean()
    wanted = gamma_to_linear(srgb) / gamma_to_linear(srgb).mean()
    assert np.abs(found - wanted).max() < 0.12


def test_mirrored_light_that_nothing_showed_is_grey(
    cloud: SurfaceCloud, observation: Observation
) -> None:
    seen = photographed(cloud, 0.5, Daylight(mirror=0.0, contrast=0.0))
    light, _ = estimate_light(cloud, [seen], observation)
    assert light.mirror > 0.3 and light.clouds > 0.6


def test_road_tells_the_light(observation: Observation) -> None:
    levels = [road_level(road_light(under(observation, level))) for level in (0.3, 0.6, 1.0)]
    assert levels == sorted(levels)
    assert levels[2] == pytest.approx(1.0, abs=0.2)
    cut_out = observation.rgba * (observation.rgba[..., 3:] > 0)
    nothing = road_light(replace(observation, rgba=cut_out))
    assert (road_level(nothing), road_tint(nothing)) == (1.0, (1.0, 1.0, 1.0))  # not night


def test_windows_and_rims_are_as_dark_as_seen(cloud: SurfaceCloud) -> None:
    day = Daylight()
    assert estimate_rims(cloud, [photographed(cloud, 0.4, day)], day) > 0.8
    assert estimate_rims(cloud, [photographed(cloud, 0.4, day, rims=0.3)], day) < 0.45
    bright, dark = (
        sum(estimate_windows(cloud, [photographed(cloud, 0.4, day, windows=share)], day))
        for share in (1.0, 0.2)
    )
    assert bright > 1.5 and dark < 0.8
    blind = replace(photographed(cloud, 0.4, day), weight=np.zeros(len(cloud.points)))
    assert estimate_rims(cloud, [blind], day) == 0.4
    assert estimate_windows(cloud, [blind], day) == (0.6, 0.55)


def test_studio_light_from_all_sides(cloud: SurfaceCloud, observation: Observation) -> None:
    """Between studio lamps flanks are as bright as the roof, and an unseen bonnet is too."""
    seen = photographed(cloud, 0.4, Daylight(contrast=0.1))
    light, _ = estimate_light(cloud, [seen], observation)
    assert light.contrast < 0.4
    light, _ = estimate_light(cloud, [photographed(cloud, 0.4, Daylight())], observation)
    assert light.contrast > 0.7


def test_a_distant_slanted_side_is_left_to_the_model(
    cloud: SurfaceCloud, observation: Observation
) -> None:
    """Far away a side seen at 20 degrees is a smear, nearby it is not."""
    placement = TemplatePlacement(np.ones(3), np.array([0.0, 0.0, -made_up.SIZE[2] / 2]), 1.0)
    near = view_surface(cloud, observation, placement)
    slanted = np.sum(cloud.normals * near.views, axis=1)
    chosen = (slanted > 0.25) & (slanted < 0.38) & (near.weight > 0.1)
    width, height = observation.camera.width // 4, observation.camera.height // 4
    coarse = replace(
        observation,
        rgba=cv2.resize(observation.rgba, (width, height), interpolation=cv2.INTER_AREA),
        camera=observation.camera.resized(width, height),
    )
    far = view_surface(cloud, coarse, placement)
    assert chosen.sum() > 50
    assert far.weight[chosen].mean() < 0.35 * near.weight[chosen].mean()
