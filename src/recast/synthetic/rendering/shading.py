"""The radiance that leaves surfaces towards the viewer."""

from __future__ import annotations

import numpy as np

from recast.synthetic.rendering.embree import Float32Array
from recast.synthetic.rendering.lighting import PI, Light, sun_cosine
from recast.synthetic.rendering.ray_scene import PosedScene
from recast.synthetic.rendering.reflection import fresnel, reflected
from recast.synthetic.rendering.sky_light import HAZE_LENGTH, SkyLight
from recast.synthetic.rendering.surface_points import TABLE, SurfacePoints
from recast.synthetic.rendering.textures import textured
from recast.synthetic.rendering.vectors import outer, rows, scale, scaled


def shade(
    posed: PosedScene,
    light: SkyLight,
    points: SurfacePoints,
    arriving: Light,
    pixel_angle: float,
) -> Float32Array:
    """Radiance (N, 3): textured diffuse part, emission, reflection, seen through haze.

    Args:
        pixel_angle: radians between neighbouring rays, for the detail of textures.
    """
    radiance = outer(arriving.sun * sun_cosine(light, points) / PI, light.sun)
    radiance += arriving.sky
    glowing = np.flatnonzero(TABLE.emission[points.material] > 0)
    emission = TABLE.emission[points.material[glowing]] * np.float32(light.white)
    radiance[glowing] += emission[:, None]
    radiance *= textured(points, pixel_angle)
    index = np.flatnonzero(TABLE.specular[points.material] > 0)
    coat = points.take(index)
    share = fresnel(coat)
    bare = np.where(TABLE.metallic[coat.material], np.float32(0), 1 - share.max(axis=1))
    light_there = Light(rows(arriving.sun, index), rows(arriving.sky, index))
    share *= reflected(posed, light, coat, light_there)
    share += scaled(rows(radiance, index), bare)
    radiance[index] = share
    clear = np.exp(points.distance / np.float32(-HAZE_LENGTH))
    scale(radiance, clear)
    radiance += outer(1 - clear, light.haze)
    return radiance
