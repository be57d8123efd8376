"""Daylight baked into spherical harmonics: diffuse light plus the sky mirrored in clear coat.

A black car is read by what it mirrors: bonnet and roof show the sky, flanks the dark horizon. The
mirrored light moves with the viewer, so colours are computed for many view directions and fitted
by harmonics of degree one, Gaussian by Gaussian.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

Array = NDArray[np.float64]

SH_C0 = 0.28209479177387814
SH_C1 = 0.4886025119029199
_F0 = 0.04  # reflectance of clear coat and glass at normal incidence
# Linear light of what a car mirrors on a clear day in a street with trees.
_SKY = np.array([0.24, 0.44, 0.82])
_HAZE = np.array([0.50, 0.62, 0.76])
_TREES = np.array([0.045, 0.050, 0.045])
_ROAD = np.array([0.09, 0.09, 0.09])


@dataclass(frozen=True)
class Daylight:
    """How a photograph's light differs from the model's clear day.

    Attributes:
        level: factor on the light that falls on the vehicle; about 0.4 in the shade of houses.
        mirrored: (3,) factors on the light that it mirrors.
    """

    level: float
    mirrored: Array


CLEAR_DAY = Daylight(1.0, np.ones(3))


def to_linear(srgb: Array) -> Array:
    """Linear light of display values in [0, 1], by the power law 2.2."""
    return np.power(np.clip(srgb, 0.0, 1.0), 2.2)


def to_display(linear: Array) -> Array:
    """Display values of linear light, clipped to [0, 1]."""
    return np.power(np.clip(linear, 0.0, 1.0), 1 / 2.2)


def environment(direction: Array) -> Array:
    """Linear light (..., 3) that arrives from directions (..., 3): road, trees, haze, sky."""
    elevation = np.degrees(np.arcsin(np.clip(direction[..., 2], -1, 1)))[..., None]
    sky = _ramp(elevation, 7, 18)
    zenith = _ramp(elevation, 20, 60)
    ground = _ramp(-elevation, 0, 8)
    above = (1 - sky) * _TREES + sky * ((1 - zenith) * _HAZE + zenith * _SKY)
    return (1 - ground) * above + ground * _ROAD


def _ramp(x: Array, low: float, high: float) -> Array:
    t = np.clip((x - low) / (high - low), 0.0, 1.0)
    return t * t * (3 - 2 * t)


def diffuse(normals: Array, heights: Array) -> Array:
    """Diffuse light (N, 1) on normals (N, 3): 1 facing up, darker below and near the ground."""
    up = 0.5 + 0.5 * normals[:, 2]
    near_ground = np.clip(heights / 0.5, 0.0, 1.0)
    return (0.26 + 0.74 * up * (0.55 + 0.45 * near_ground))[:, None]


def mirrored(normals: Array, views: Array, gloss: Array) -> Array:
    """Mirrored light (N, 3) towards unit directions `views` (N, 3) from the surface to the eye."""
    cosine = np.sum(normals * views, axis=1, keepdims=True)
    reflected = 2 * cosine * normals - views
    fresnel = _F0 + (1 - _F0) * (1 - np.clip(cosine, 0.05, 1.0)) ** 5
    return np.minimum(fresnel * gloss[:, None], 0.9) * environment(reflected)


def shade(
    albedo: Array,
    gloss: Array,
    normals: Array,
    heights: Array,
    views: Array,
    light: Daylight = CLEAR_DAY,
) -> Array:
    """Display colours (N, 3) seen from directions `views` (N, 3) from the surface to the eye.

    Args:
        albedo: (N, 3) linear diffuse reflectance.
        gloss: (N,) factor on the Fresnel reflection of a clear coat.
        heights: (N,) metres above the ground.
        light: what falls on it.
    """
    scattered = light.level * albedo * diffuse(normals, heights)
    return to_display(scattered + light.mirrored * mirrored(normals, views, gloss))


def view_directions() -> Array:
    """(V, 3) unit directions to the eyes of road users: all around, 4 degrees below to 45 above."""
    azimuth = np.linspace(0, 2 * np.pi, 16, endpoint=False)
    elevation = np.radians([-4.0, 8.0, 24.0, 45.0])
    a, e = np.meshgrid(azimuth, elevation)
    return np.stack([np.cos(e) * np.cos(a), np.cos(e) * np.sin(a), np.sin(e)], -1).reshape(-1, 3)


def sh_basis(directions: Array) -> Array:
    """Real harmonics (..., 4) up to degree one of unit directions (..., 3) from eye to surface."""
    x, y, z = np.moveaxis(directions, -1, 0)
    return np.stack([np.full_like(x, SH_C0), -SH_C1 * y, SH_C1 * z, -SH_C1 * x], axis=-1)


def fit_harmonics(
    albedo: Array, gloss: Array, normals: Array, heights: Array, light: Daylight = CLEAR_DAY
) -> Array:
    """SH coefficients (N, 4, 3) whose colour `basis . sh + 0.5` follows `shade` where visible.

    Weighted least squares over the view directions on the outer side, with a ridge on degree one
    so that what is seen only at a grazing angle does not steer the rest.
    """
    views = view_directions()
    basis = sh_basis(-views)
    facing = np.sqrt(np.clip(normals @ views.T, 0.0, None)) * (1.2 - views[:, 2])
    normal = np.einsum("nv,vi,vj->nij", facing, basis, basis)
    right = np.zeros((len(normals), 4, 3))
    for v, view in enumerate(views):
        seen = np.flatnonzero(facing[:, v] > 0)
        colour = shade(albedo[seen], gloss[seen], normals[seen], heights[seen], view[None], light)
        right[seen] += (facing[seen, v, None] * basis[v])[:, :, None] * (colour - 0.5)[:, None, :]
    # a Gaussian seen from nowhere takes this ridge's target: its diffuse colour in the shade
    ridge = np.array([1e-3, 0.15, 0.15, 0.15])
    right[:, 0] += ridge[0] * (to_display(0.3 * light.level * albedo) - 0.5) / SH_C0
    coefficients: Array = np.linalg.solve(normal + np.diag(ridge), right)
    return coefficients
