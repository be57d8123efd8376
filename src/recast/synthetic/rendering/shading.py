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
    radiance = (arriving.sun * sun_cosine(light, points) / PI)[:, None] * light.sun
    radiance += arriving.sky
    coat = np.flatnonzero(TABLE.specular[points.material] > 0)
    radiance += (TABLE.emission[points.material] * np.float32(light.white))[:, None]
    radiance *= textured(points, pixel_angle)
    mirror = points.take(coat)
    share = fresnel(mirror)
    bare = np.where(TABLE.metallic[mirror.material], 0, 1 - share.max(axis=1))
    coat_light = Light(arriving.sun[coat], arriving.sky[coat])
    radiance[coat] = radiance[coat] * bare[:, None].astype(np.float32) + share * reflected(
        posed, light, mirror, coat_light
    )
    clear = np.exp(points.distance / np.float32(-HAZE_LENGTH))[:, None]
    radiance -= light.haze
    radiance *= clear
    radiance += light.haze
    return radiance
