"""Light that reaches surfaces: sun, sky, and one bounce off what the sky is hidden by."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from recast.synthetic.rendering.embree import BoolArray, Float32Array
from recast.synthetic.rendering.ray_scene import PosedScene
from recast.synthetic.rendering.sampling import cosine_directions, disc_directions
from recast.synthetic.rendering.sky_light import SkyLight
from recast.synthetic.rendering.surface_points import TABLE, SurfacePoints, surface_points
from recast.synthetic.rendering.vectors import dot, outer, rows, shift

PI = np.float32(np.pi)
BOUNCE_OPENNESS = np.float32(0.55)
"""Share of the sky that a surface met by a secondary ray is taken to see."""


@dataclass(frozen=True)
class Light:
    """What arrives at N points.

    Attributes:
        sun: (N,) share of the sun's disc that is seen.
        sky: (N, 3) irradiance of everything else, divided by pi.
    """

    sun: Float32Array
    sky: Float32Array


def sample_light(
    posed: PosedScene,
    light: SkyLight,
    points: SurfacePoints,
    sun_samples: Float32Array,
    sky_samples: Float32Array,
) -> Light:
    """One sample of the sun's disc and one of the hemisphere at each of N points.

    Args:
        sun_samples, sky_samples: (N, 2) in [0, 1).
    """
    sun = np.zeros(len(points), np.float32)
    towards = sun_cosine(light, points) > 0
    lit = np.flatnonzero(towards)
    directions = disc_directions(light.sun_direction, light.sky.sun_radius, rows(sun_samples, lit))
    sun[lit] = ~posed.occluded(rows(points.origin, lit), directions)
    directions = cosine_directions(points.normal, sky_samples)
    _above_face(directions, points)
    return Light(sun, incoming(posed, light, points.origin, directions, diffuse=True))


def add_light_samples(
    posed: PosedScene,
    light: SkyLight,
    points: SurfacePoints,
    arriving: Light,
    index: NDArray[np.int64],
    count: int,
    rng: np.random.Generator,
) -> None:
    """Average `count` more samples into the light of some points that have one, in place."""
    some = points.take(index)
    sun, sky = arriving.sun[index], arriving.sky[index]
    start = rng.random((2, len(index), 2), np.float32)
    for turn in range(count):
        # Steps of the R2 sequence: spread evenly over the square from any start.
        samples = (start + np.array([0.7549, 0.5698], np.float32) * np.float32(turn)) % 1
        further = sample_light(posed, light, some, samples[0], samples[1])
        sun += further.sun
        sky += further.sky
    arriving.sun[index], arriving.sky[index] = sun / (count + 1), sky / np.float32(count + 1)


def incoming(
    posed: PosedScene,
    light: SkyLight,
    origins: Float32Array,
    directions: Float32Array,
    *,
    diffuse: bool = False,
) -> Float32Array:
    """Radiance (N, 3) that arrives at `origins` from `directions`, with one bounce, no textures.

    Args:
        diffuse: passed to `SkyLight.radiance`.
    """
    hits = posed.cast(origins, directions)
    rays, points = surface_points(posed, origins, directions, hits, smooth=False)
    missed = np.flatnonzero(hits.face < 0)
    radiance = np.empty((len(origins), 3), np.float32)
    radiance[missed] = light.radiance(rows(directions, missed), diffuse=diffuse)
    radiance[rays] = flat_shading(posed, light, points)
    return radiance


def flat_shading(posed: PosedScene, light: SkyLight, points: SurfacePoints) -> Float32Array:
    """Radiance (N, 3) of points as diffuse surfaces: hard sun shadow, sky as if half open."""
    cosine = sun_cosine(light, points)
    lit = np.flatnonzero(cosine > 0)
    towards = np.ascontiguousarray(
        np.broadcast_to(light.sun_direction.astype(np.float32), (len(lit), 3))
    )
    shadowed = posed.occluded(rows(points.origin, lit), towards)
    cosine[lit[shadowed]] = 0
    radiance = outer(cosine / PI, light.sun)
    radiance += open_ambient(light, points.normal) * BOUNCE_OPENNESS
    glowing = np.flatnonzero(TABLE.emission[points.material] > 0)
    radiance[glowing] += (TABLE.emission[points.material[glowing]] * np.float32(light.white))[
        :, None
    ]
    radiance *= points.colour
    return radiance


def open_ambient(light: SkyLight, normals: Float32Array) -> Float32Array:
    """Irradiance over pi (N, 3) on surfaces in the open: sky from above, ground from below."""
    up = np.float32(0.5) + np.float32(0.5) * normals[:, 2]
    return shift(outer(up, light.ambient - light.ground), light.ground)


def sun_cosine(light: SkyLight, points: SurfacePoints) -> Float32Array:
    """Cosine (N,) between sun and shading normal, 0 where the face itself looks away."""
    sun = light.sun_direction.astype(np.float32)
    cosine = np.maximum(points.normal @ sun, 0)
    if sun[2] <= 0:
        return np.zeros_like(cosine)
    away: BoolArray = points.flat @ sun <= 0
    cosine[away] = 0
    return cosine


def _above_face(directions: Float32Array, points: SurfacePoints) -> None:
    """Mirror directions that a bent shading normal sent into the surface, in place."""
    below = dot(directions, points.flat)
    into = np.flatnonzero(below < 0)
    directions[into] -= 2 * below[into][:, None] * points.flat[into]
