"""One image, ray by ray: the stages of `render_camera`."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from recast.geometry import PinholeCamera
from recast.synthetic.rendering.antialias import OFFSETS, borrow_light, edge_pixels
from recast.synthetic.rendering.camera_frame import CameraFrame
from recast.synthetic.rendering.embree import Float32Array
from recast.synthetic.rendering.light_filter import LightFilter
from recast.synthetic.rendering.lighting import Light, add_light_samples, sample_light
from recast.synthetic.rendering.path_light import path_light
from recast.synthetic.rendering.ray_scene import SKY, Hits, PosedScene
from recast.synthetic.rendering.sampling import pixel_samples
from recast.synthetic.rendering.shading import shade
from recast.synthetic.rendering.sky_light import SkyLight
from recast.synthetic.rendering.surface_points import SurfacePoints, surface_points
from recast.synthetic.rendering.tone import CLIP, WHITE_LEVEL, develop
from recast.synthetic.rendering.vectors import dot, normalise
from recast.synthetic.world import Quality

Array = NDArray[np.float64]
Index = NDArray[np.int64]

LONELY_SAMPLES = 4
"""Further samples of light where the filter finds no neighbours to average with."""


class Film:
    """Sums of the light of each pixel's rays.

    Args:
        light: what is seen where nothing is hit.
        exposure: factor on the light.
        transparent: rays that hit nothing leave no light and do not count.
    """

    def __init__(self, light: SkyLight, exposure: float, count: int, *, transparent: bool) -> None:
        self._light, self._exposure, self._transparent = light, exposure, transparent
        self._clip = np.float32(CLIP * light.white / (exposure * WHITE_LEVEL))
        self._sums = np.zeros((count, 3), np.float32)
        self._covered = np.zeros(count, np.float32)
        self._rays = np.zeros(count, np.float32)

    def add(
        self, pixels: Index, directions: Float32Array, hits: Hits, at: Index, shaded: Float32Array
    ) -> None:
        """One ray each of `pixels`, each at most once; rays `at` brought the light `shaded`."""
        self._rays[pixels] += 1
        self._covered[pixels[at]] += 1
        self._sums[pixels[at]] += np.minimum(shaded, self._clip)
        if not self._transparent:
            missed = np.flatnonzero(hits.instance == SKY)
            sky = self._light.background(directions[missed])
            self._sums[pixels[missed]] += np.minimum(sky, self._clip)

    def develop(self) -> NDArray[np.uint8]:
        """(N, 3) uint8 sRGB."""
        weight = np.maximum(self._covered, 1) if self._transparent else self._rays
        mean = (self._sums / weight[:, None]).astype(np.float32, copy=False)
        return develop(mean, self._light.white, self._exposure)

    def alpha(self) -> Float32Array:
        """(N,) share of rays that hit something."""
        return self._covered / self._rays


def trace_image(
    posed: PosedScene,
    light: SkyLight,
    camera: PinholeCamera,
    world_from_camera: Array,
    rng: np.random.Generator,
    exposure: float,
    quality: Quality,
) -> CameraFrame:
    """The image of a scene; arguments as of `render_camera`, checked."""
    height, width = camera.height, camera.width
    pixel_angle = 1 / np.sqrt(camera.fx * camera.fy)
    transparent = not len(posed.scene.static)
    film = Film(light, exposure, height * width, transparent=transparent)

    grid = camera.pixel_grid().reshape(-1, 2)
    origins, directions, stretch = camera_rays(camera, world_from_camera, grid)
    hits = posed.cast(origins, directions)
    pixels, points = surface_points(posed, origins, directions, hits)
    samples = [pixel_samples(height, width, rng).reshape(-1, 2)[pixels] for _ in range(2)]
    noisy = sample_light(posed, light, points, *samples)
    light_filter = LightFilter(points, pixels, height, width)
    add_light_samples(posed, light, points, noisy, light_filter.lonely(), LONELY_SAMPLES, rng)
    if quality == "mitsuba":
        noisy = Light(noisy.sun, path_light(posed, light, points, rng))
    arriving = light_filter.smooth(noisy)
    shaded = shade(posed, light, points, arriving, pixel_angle)
    film.add(np.arange(height * width), directions, hits, pixels, shaded)

    edges = edge_pixels(points, pixels, shaded, light.white, height, width)
    for offset in OFFSETS:
        origins, directions, _ = camera_rays(camera, world_from_camera, grid[edges] + offset)
        further = posed.cast(origins, directions)
        at, others = surface_points(posed, origins, directions, further)
        borrowed, alone = borrow_light(
            points, pixels, arriving, others, edges[at], offset, height, width
        )
        _light_alone(posed, light, others, borrowed, alone, rng)
        shaded = shade(posed, light, others, borrowed, pixel_angle)
        film.add(edges, directions, further, at, shaded)

    return CameraFrame(
        film.develop().reshape(height, width, 3),
        (hits.distance / stretch).reshape(height, width),
        hits.instance.reshape(height, width),
        film.alpha().reshape(height, width),
    )


def camera_rays(
    camera: PinholeCamera, world_from_camera: Array, pixels: Array
) -> tuple[Float32Array, Float32Array, Float32Array]:
    """Origins, unit directions, and the lengths of the directions at unit depth."""
    local = camera.rays(pixels)
    directions = (local @ world_from_camera[:3, :3].T).astype(np.float32)
    stretch = np.sqrt(dot(directions, directions))
    origins = np.empty_like(directions)
    origins[:] = world_from_camera[:3, 3]
    return origins, normalise(directions), stretch


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
