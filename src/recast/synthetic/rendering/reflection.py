"""Mirror reflection of clear coats, glass and metal, and the sun's highlight in them."""

from __future__ import annotations

import numpy as np

from recast.synthetic.rendering.embree import Float32Array
from recast.synthetic.rendering.lighting import PI, Light, incoming
from recast.synthetic.rendering.ray_scene import PosedScene
from recast.synthetic.rendering.sky_light import SkyLight
from recast.synthetic.rendering.surface_points import TABLE, SurfacePoints
from recast.synthetic.rendering.vectors import dot, normalise, outer, scaled

MIRROR_ROUGHNESS = 0.1
"""Up to here a surface mirrors; beyond, its reflection is a blur like its diffuse light."""
HIGHLIGHT_ROUGHNESS = np.float32(0.2)
"""Least width of the sun's highlight: a mirror's would be a few pixels far beyond white."""
HIGHLIGHT_LIMIT = np.float32(20.0)
"""Most that the lobe of the highlight may be, 1/sr."""


def fresnel(points: SurfacePoints) -> Float32Array:
    """Reflectance (N, 3) of materials with a specular part; metals take the colour of the face.

    Schlick, "An inexpensive BRDF model for physically-based rendering" (1994).
    """
    base = TABLE.specular[points.material][:, None]
    metallic = TABLE.metallic[points.material][:, None]
    base = base * np.where(metallic, points.colour, np.float32(1))
    grazing = (1 - points.cosine) ** 5
    # Rough surfaces hide themselves at grazing angles.
    grazing *= 1 - TABLE.roughness[points.material]
    return base + (1 - base) * grazing[:, None]


def reflected(
    posed: PosedScene, light: SkyLight, points: SurfacePoints, arriving: Light
) -> Float32Array:
    """Radiance (N, 3) that a perfect coat on the points would reflect, sun included.

    Args:
        points: all of materials that have a specular part.
        arriving: the light at the points: sun seen, and blurred surroundings.
    """
    radiance = arriving.sky.copy()
    mirror = np.flatnonzero(TABLE.roughness[points.material] <= MIRROR_ROUGHNESS)
    coat = points.take(mirror)
    directions = mirror_directions(coat.view, coat.normal, coat.flat)
    radiance[mirror] = incoming(posed, light, coat.origin, directions)
    radiance += _highlight(light, points, arriving.sun)
    return radiance


def mirror_directions(view: Float32Array, normal: Float32Array, flat: Float32Array) -> Float32Array:
    """Unit directions (N, 3) of `view` mirrored at `normal`, kept outside the face `flat`."""
    directions = view - scaled(normal, 2 * dot(view, normal))
    below = np.minimum(dot(directions, flat) - np.float32(0.01), 0)
    directions -= scaled(flat, 2 * below)
    return normalise(directions)


def _highlight(light: SkyLight, points: SurfacePoints, sun: Float32Array) -> Float32Array:
    """The sun in a slightly rough surface (N, 3): lobe of Blinn (1977), energy kept."""
    towards = light.sun_direction.astype(np.float32)
    half = normalise(towards - points.view + np.float32(1e-6))
    width = np.maximum(TABLE.roughness[points.material], HIGHLIGHT_ROUGHNESS) ** 2
    exponent = 2 / width**2 - 2
    cosine = np.clip(dot(points.normal, half), 0, 1)
    lobe = np.minimum((exponent + 2) / (8 * PI) * cosine**exponent, HIGHLIGHT_LIMIT)
    facing = points.normal @ towards > 0
    return outer(lobe * facing * sun, light.sun)
