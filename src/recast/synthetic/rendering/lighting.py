"""Light that reaches surfaces: sun, sky, and one bounce off what the sky is hidden by, filtered.

The filter is an a-trous one (Dammertz et al., "Edge-avoiding a-trous wavelet transform for fast
global illumination filtering", 2010) on the light alone, colours and textures left out of it;
separable, with weights from normals and from distance to one another's planes, so that nothing is
blurred across edges.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from recast.synthetic.rendering import compiled
from recast.synthetic.rendering.ray_scene import PosedScene
from recast.synthetic.rendering.rays import (
    BoolArray,
    Float32Array,
    cosine_directions,
    disc_directions,
    dot,
    outer,
    rows,
    shift,
)
from recast.synthetic.rendering.sky import SkyLight
from recast.synthetic.rendering.surface_points import TABLE, SurfacePoints, surface_points

PI = np.float32(np.pi)
BOUNCE_OPENNESS = np.float32(0.55)
"""Share of the sky that a surface met by a secondary ray is taken to see."""
SUN_STEPS = (1, 2)
"""Pixels between the taps of each pass over the sun's share."""
SKY_STEPS = (1, 2, 4, 8, 16)
"""The same over the light of the sky."""
PLANE_TOLERANCE = np.float32(0.02)
"""Metres off each other's plane at which neighbours 1 m away from the camera count a quarter."""
NORMAL_POWER = 16
"""Of the cosine between normals; a power of two."""
LEAST_SUPPORT = np.float32(0.9)
"""Sum of the weights of the four neighbours, each at most 1/2, below which a point is alone."""


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
    light: SkyLight, points: SurfacePoints, sun_samples: Float32Array, sky_samples: Float32Array
) -> Light:
    """One sample of the sun's disc and one of the hemisphere at each of N points.

    Args:
        sun_samples, sky_samples: (N, 2) in [0, 1).
    """
    sun = np.zeros(len(points), np.float32)
    towards = sun_cosine(light, points) > 0
    lit = np.flatnonzero(towards)
    directions = disc_directions(light.sun_direction, light.sky.sun_radius, rows(sun_samples, lit))
    sun[lit] = ~points.posed.occluded(rows(points.origin, lit), directions, coherent=True)
    directions = cosine_directions(points.normal, sky_samples)
    _above_face(directions, points)
    return Light(sun, incoming(points.posed, light, points.origin, directions, diffuse=True))


def add_light_samples(
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
        further = sample_light(light, some, samples[0], samples[1])
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
    radiance[rays] = flat_shading(light, points)
    return radiance


def flat_shading(light: SkyLight, points: SurfacePoints) -> Float32Array:
    """Radiance (N, 3) of points as diffuse surfaces: hard sun shadow, sky as if half open."""
    cosine = sun_cosine(light, points)
    lit = np.flatnonzero(cosine > 0)
    towards = np.ascontiguousarray(
        np.broadcast_to(light.sun_direction.astype(np.float32), (len(lit), 3))
    )
    shadowed = points.posed.occluded(rows(points.origin, lit), towards)
    cosine[lit[shadowed]] = 0
    radiance = outer(cosine / PI, light.sun)
    radiance += open_ambient(light, points.normal) * BOUNCE_OPENNESS
    glowing = np.flatnonzero(TABLE.emission[points.material] > 0)
    emission = TABLE.emission[points.material[glowing]] * np.float32(light.white)
    radiance[glowing] += emission[:, None]
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


class LightFilter:
    """The filter for one image.

    Args:
        points: what the pixels' centres show.
        pixels: (N,) row-major index of each point's pixel; the others are sky.
        height, width: size of the image in pixels.
    """

    def __init__(
        self, points: SurfacePoints, pixels: NDArray[np.int64], height: int, width: int
    ) -> None:
        self._pixels, self._shape = pixels, (height, width)
        guide = np.zeros((7, height * width), np.float32)
        guide[:3, pixels] = points.position.T
        guide[3:6, pixels] = points.normal.T
        guide[6, pixels] = 1 / (PLANE_TOLERANCE * (1 + np.float32(0.1) * points.distance))
        self._guide = guide.reshape(7, height, width)

    def lonely(self) -> NDArray[np.int64]:
        """Indices of points with hardly a neighbour to share samples with: poles, leaves."""
        support = np.zeros(self._shape, np.float32)
        for axis in (1, 2):
            ahead, behind = _shifted(axis, 1)
            weight = _pair_weight(self._guide[behind], self._guide[ahead])
            support[ahead[1:]] += weight
            support[behind[1:]] += weight
        return np.flatnonzero(support.ravel()[self._pixels] < LEAST_SUPPORT)

    def smooth(self, noisy: Light) -> Light:
        """Smoothed light of the points."""
        rows = np.zeros((4, self._shape[0] * self._shape[1]), np.float32)
        rows[0, self._pixels] = noisy.sun
        rows[1:, self._pixels] = noisy.sky.T
        value = rows.reshape(4, *self._shape)
        first = [0 if step in SUN_STEPS else 1 for step in SKY_STEPS]
        if not compiled.smooth(value, self._guide, SKY_STEPS, first):
            for step, channel in zip(SKY_STEPS, first, strict=True):
                for axis in (1, 2):
                    value[channel:] = _pass(value[channel:], self._guide, step, axis)
        flat = np.take(value.reshape(4, -1), self._pixels, axis=1)
        return Light(flat[0], np.ascontiguousarray(flat[1:].T))


def _shifted(axis: int, step: int) -> tuple[tuple[slice, ...], tuple[slice, ...]]:
    """Index of (channels, H, W) without the first, and without the last `step` of an axis."""
    before = (slice(None),) * axis
    return (*before, slice(step, None)), (*before, slice(None, -step))


def _pass(value: Float32Array, guide: Float32Array, step: int, axis: int) -> Float32Array:
    """Three taps (1/4, 1/2, 1/4), `step` pixels apart, along one axis of (channels, H, W)."""
    if value.shape[axis] <= step:
        return value
    ahead, behind = _shifted(axis, step)
    # The weight between two pixels is the same both ways: computed once for each pair.
    weight = _pair_weight(guide[behind], guide[ahead])
    total = np.ones(value.shape[1:], np.float32)
    total[ahead[1:]] += weight
    total[behind[1:]] += weight
    sums = value.copy()
    sums[ahead] += weight * value[behind]
    sums[behind] += weight * value[ahead]
    sums /= total
    return sums


def _pair_weight(first: Float32Array, second: Float32Array) -> Float32Array:
    """Half the likeness (H, W) of pixels as surfaces: 0.5 on one plane, 0 beyond an edge."""
    parallel = first[3] * second[3]
    parallel += first[4] * second[4]
    parallel += first[5] * second[5]
    off = (second[0] - first[0]) * (first[3] + second[3])
    off += (second[1] - first[1]) * (first[4] + second[4])
    off += (second[2] - first[2]) * (first[5] + second[5])
    off *= np.minimum(first[6], second[6])
    off *= off
    np.maximum(parallel, 0, out=parallel)
    for _ in range(NORMAL_POWER.bit_length() - 1):
        parallel *= parallel
    off += 1
    off *= off
    parallel /= off
    parallel *= np.float32(0.5)
    return parallel
