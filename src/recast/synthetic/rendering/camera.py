"""Images of a scene by ray tracing: what a camera on a car would take."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import ArrayLike, NDArray

from recast.geometry import PinholeCamera
from recast.synthetic.rendering.antialias import OFFSETS, borrow_light, edge_pixels
from recast.synthetic.rendering.embree import Float32Array
from recast.synthetic.rendering.light_filter import LightFilter
from recast.synthetic.rendering.lighting import Light, add_light_samples, sample_light
from recast.synthetic.rendering.ray_scene import SKY, PosedScene, Poses, RayScene
from recast.synthetic.rendering.sampling import pixel_samples
from recast.synthetic.rendering.shading import shade
from recast.synthetic.rendering.sky_light import SkyLight, sky_light
from recast.synthetic.rendering.surface_points import SurfacePoints, surface_points
from recast.synthetic.rendering.tone import CLIP, WHITE_LEVEL, develop
from recast.synthetic.rendering.vectors import dot, normalise
from recast.synthetic.world import Sky

Array = NDArray[np.float64]

LONELY_SAMPLES = 4
"""Further samples of light where the filter finds no neighbours to average with."""


@dataclass(frozen=True)
class CameraFrame:
    """One image and what is exactly known about it.

    Attributes:
        rgb: (H, W, 3) uint8 sRGB. In front of an empty street: the colour of the vehicles alone,
            not mixed with anything behind them.
        depth: (H, W) float32 metres along the camera's z axis through the pixel centre, inf where
            the sky is.
        instance: (H, W) uint16 at the pixel centre: 0 the street, i + 1 the i-th of the scene's
            sorted model names, `SKY` where nothing is.
        alpha: (H, W) float32 share of the pixel that is not sky.
    """

    rgb: NDArray[np.uint8]
    depth: Float32Array
    instance: NDArray[np.uint16]
    alpha: Float32Array


def render_camera(
    scene: RayScene,
    sky: Sky,
    camera: PinholeCamera,
    world_from_camera: ArrayLike,
    poses: Poses,
    *,
    rng: np.random.Generator,
    exposure: float = 1.0,
) -> CameraFrame:
    """Take one image.

    Args:
        scene: may have an empty street.
        sky: daylight.
        camera: may have distortion.
        world_from_camera: (4, 4) rigid.
        poses: `world_from_actor` (4, 4) by model name; models not named are absent.
        rng: of the samples of light.
        exposure: factor on the light, 1 is right for the day.

    Raises:
        ValueError: a size or a pose that cannot be, an exposure that is not positive, or a name
            that is not among the models.
    """
    camera.validate()
    pose = np.asarray(world_from_camera, np.float64)
    if pose.shape != (4, 4) or not np.all(np.isfinite(pose)):
        raise ValueError(f"world_from_camera: expected a finite (4, 4), got {pose.shape}")
    if not (np.isfinite(exposure) and exposure > 0):
        raise ValueError(f"exposure: must be positive, got {exposure}")
    posed, light = scene.posed(poses), sky_light(sky)
    height, width = camera.height, camera.width
    clip = np.float32(CLIP * light.white / (exposure * WHITE_LEVEL))

    grid = camera.pixel_grid().reshape(-1, 2)
    origins, directions, stretch = _rays(camera, pose, grid)
    hits = posed.cast(origins, directions)
    pixels, points = surface_points(posed, origins, directions, hits)
    sun_samples = pixel_samples(height, width, rng).reshape(-1, 2)[pixels]
    sky_samples = pixel_samples(height, width, rng).reshape(-1, 2)[pixels]
    noisy = sample_light(posed, light, points, sun_samples, sky_samples)
    light_filter = LightFilter(points, pixels, height, width)
    add_light_samples(posed, light, points, noisy, light_filter.lonely(), LONELY_SAMPLES, rng)
    arriving = light_filter.smooth(noisy)
    pixel_angle = 1 / np.sqrt(camera.fx * camera.fy)
    shaded = shade(posed, light, points, arriving, pixel_angle)

    sums = np.zeros((height * width, 3), np.float32)
    sums[pixels] = np.minimum(shaded, clip)
    covered = (hits.instance != SKY).astype(np.float32)
    rays = np.ones(height * width, np.float32)
    if len(scene.static):
        missed = np.flatnonzero(hits.instance == SKY)
        sums[missed] = np.minimum(_background(light, directions[missed]), clip)

    edges = edge_pixels(points, pixels, shaded, light.white, height, width)
    for offset in OFFSETS:
        origins, directions, _ = _rays(camera, pose, grid[edges] + offset)
        further = posed.cast(origins, directions)
        index, others = surface_points(posed, origins, directions, further)
        borrowed, alone = borrow_light(
            points, pixels, arriving, others, edges[index], offset, height, width
        )
        _light_alone(posed, light, others, borrowed, alone, rng)
        shaded = shade(posed, light, others, borrowed, pixel_angle)
        sums[edges[index]] += np.minimum(shaded, clip)
        covered[edges[index]] += 1
        rays[edges] += 1
        if len(scene.static):
            missed = np.flatnonzero(further.instance == SKY)
            sums[edges[missed]] += np.minimum(_background(light, directions[missed]), clip)

    weight = rays if len(scene.static) else np.maximum(covered, 1)
    rgb = develop(sums / weight[:, None], light.white, exposure)
    depth = hits.distance / stretch
    return CameraFrame(
        rgb.reshape(height, width, 3),
        depth.reshape(height, width),
        hits.instance.reshape(height, width),
        (covered / rays).reshape(height, width),
    )


def _rays(
    camera: PinholeCamera, pose: Array, pixels: Array
) -> tuple[Float32Array, Float32Array, Float32Array]:
    """Origins, unit directions, and the lengths of the directions at unit depth."""
    local = camera.rays(pixels)
    directions = (local @ pose[:3, :3].T).astype(np.float32)
    stretch = np.sqrt(dot(directions, directions))
    origins = np.empty_like(directions)
    origins[:] = pose[:3, 3]
    return origins, normalise(directions), stretch


def _background(light: SkyLight, directions: Float32Array) -> Float32Array:
    """The sky (N, 3) with the sun's disc."""
    radiance = light.radiance(directions)
    disc = light.disc(directions)
    radiance += disc[:, None] * (light.sun * np.float32(30))
    return radiance


def _light_alone(
    posed: PosedScene,
    light: SkyLight,
    points: SurfacePoints,
    borrowed: Light,
    alone: NDArray[np.int64],
    rng: np.random.Generator,
) -> None:
    """Sample the light of points that none could be borrowed for, in place."""
    lonely = points.take(alone)
    samples = rng.random((2, len(alone), 2), np.float32)
    own = sample_light(posed, light, lonely, samples[0], samples[1])
    borrowed.sun[alone] = own.sun
    borrowed.sky[alone] = own.sky
