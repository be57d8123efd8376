"""The sky as a light: radiance from every direction, sun glow, clouds, haze, ground far away."""

from __future__ import annotations

from dataclasses import dataclass
from functools import lru_cache

import cv2
import numpy as np
from numpy.typing import NDArray

from recast.arrays import Array
from recast.synthetic.rendering import compiled
from recast.synthetic.rendering.rays import (
    BoolArray,
    Float32Array,
    PosedScene,
    cosine_directions,
    disc_directions,
    dot,
    outer,
    rows,
    shift,
)
from recast.synthetic.rendering.surface_points import (
    LUMINANCE,
    TABLE,
    SurfacePoints,
    gather_image,
    spectral_noise,
    surface_points,
)
from recast.synthetic.world import Sky

HAZE_LENGTH = 1800.0
"""Metres after which haze leaves 1/e of a surface's light."""
GROUND_ALBEDO = np.array([0.17, 0.17, 0.14])
"""Albedo of the plain beyond the end of the scene."""
DISC = np.float32(30.0)
"""Radiance of the sun's disc over its irradiance; far less than it is, and still beyond white."""
_EYE_HEIGHT = 2.0
_SKY_ROWS, _SKY_COLUMNS = 512, 1536


class SkyLight:
    """Radiance of the sky and of a hazy plain below the horizon, tabulated.

    Rows of the table are sgn(z) sqrt(|z|), so that most of them lie near the horizon, where
    cameras on cars look; columns are azimuth.

    Attributes:
        sky: what it was made of.
        ambient: (3,) irradiance of the upper hemisphere on level ground, divided by pi.
        ground: (3,) radiance of sunlit open ground of `GROUND_ALBEDO`.
        white: luminance of a white level surface in the open: the unit of exposure and emission.
        haze: (3,) radiance that takes the place of far surfaces.
    """

    def __init__(self, sky: Sky) -> None:
        self.sky = sky
        self.sun_direction = np.asarray(sky.sun_direction, np.float64)
        self.sun_direction = self.sun_direction / np.linalg.norm(self.sun_direction)
        self.sun = np.asarray(sky.sun, np.float32)
        self.haze = np.asarray(sky.horizon, np.float32)
        v = (np.arange(_SKY_ROWS) + 0.5) / _SKY_ROWS * 2 - 1
        z = np.sign(v) * v * v
        azimuth = (np.arange(_SKY_COLUMNS) + 0.5) / _SKY_COLUMNS * 2 * np.pi
        level = np.sqrt(np.maximum(1 - z * z, 0))[:, None]
        directions = np.stack(
            np.broadcast_arrays(level * np.cos(azimuth), level * np.sin(azimuth), z[:, None]), -1
        )
        upper = directions[z > 0]
        above = self._above(upper)
        # A row covers dz = 2 |v| dv; the irradiance weighs by z once more.
        weight = (z * np.abs(v))[z > 0]
        self.ambient = np.average(above.mean(axis=1), axis=0, weights=weight).astype(np.float32)
        beam = self.sun * np.float32(max(self.sun_direction[2], 0.0) / np.pi)
        white = beam + self.ambient
        self.white = float(white @ LUMINANCE)
        self.ground = (GROUND_ALBEDO * white).astype(np.float32)
        clear = np.exp(_EYE_HEIGHT / np.minimum(z[z <= 0], -1e-6) / HAZE_LENGTH)[:, None, None]
        below = np.broadcast_to(
            self.ground * clear + self.haze * (1 - clear), (len(clear), _SKY_COLUMNS, 3)
        )
        table = np.concatenate([below, above], axis=0)
        self._table = np.concatenate([table[:, -1:], table, table[:, :1]], axis=1)
        self._table = np.ascontiguousarray(self._table, np.float32)
        self._diffuse = np.minimum(self._table, 6 * self.ambient)

    def radiance(self, directions: Float32Array, *, diffuse: bool = False) -> Float32Array:
        """Radiance (N, 3) from unit `directions` (N, 3), the sun's disc left out.

        Args:
            directions: directions that point away from the observer.
            diffuse: clip the glow round the sun: it belongs to the sun's own samples.
        """
        count = len(directions)
        z = directions[:, 2]
        column = np.arctan2(directions[:, 1], directions[:, 0]) * np.float32(
            _SKY_COLUMNS / 2 / np.pi
        )
        column = np.where(column < 0, column + np.float32(_SKY_COLUMNS), column) + np.float32(0.5)
        row = np.copysign(np.sqrt(np.abs(z)), z) * np.float32(_SKY_ROWS / 2)
        row += np.float32(_SKY_ROWS / 2 - 0.5)
        table = self._diffuse if diffuse else self._table
        return gather_image(table, column, row)[:count]

    def background(self, directions: Float32Array) -> Float32Array:
        """What cameras see (N, 3) behind everything: the sky with the sun's disc, soft-rimmed."""
        angle = np.arccos(np.clip(directions @ self.sun_direction.astype(np.float32), -1, 1))
        radius = np.float32(max(self.sky.sun_radius, 0.005))
        shown = np.clip(2 - angle / radius, 0, 1).astype(np.float32)
        shown[directions[:, 2] <= 0] = 0
        radiance = self.radiance(directions)
        radiance += outer(shown, DISC * self.sun)
        return radiance

    def _above(self, directions: Array) -> Array:
        """Radiance (..., 3) of the upper hemisphere: gradient, glow, clouds."""
        sky = self.sky
        z = np.maximum(directions[..., 2:], 0.0)
        gradient = (1 - z) ** 5
        colour = sky.zenith + (np.asarray(sky.horizon) - sky.zenith) * (
            0.35 * (1 - z) ** 2 + 0.65 * gradient
        )
        away = 1 - directions @ self.sun_direction
        glow = 0.03 * np.exp(-6 * away) + 0.08 * np.exp(-40 * away) + 0.5 * np.exp(-900 * away)
        colour = colour + self.sun * glow[..., None] * min(1.0, 0.1 + 5 * self.sun_direction[2])
        cover = self._clouds(directions)[..., None] * np.clip(z * 7, 0, 1)
        bright = np.mean(sky.horizon) + 0.12 * self.sun + 0.25 * self.sun * glow[..., None]
        dark = 0.75 * np.mean(sky.horizon) + 0.04 * self.sun
        shade = np.clip(cover * 0.8, 0, 1)
        return colour + cover * (bright + shade * (dark - bright) - colour) * 0.85

    def _clouds(self, directions: Array) -> Array:
        """Cover in [0, 1] of a flat layer of clouds."""
        if self.sky.clouds <= 0:
            return np.zeros(directions.shape[:-1])
        size = 512
        rng = np.random.default_rng([self.sky.seed, 0xC10D])
        noise = spectral_noise(size, rng, slope=1.7, low=3)
        # The layer bends down to the horizon, as on a round earth.
        plane = directions[..., :2] / (directions[..., 2:] + 0.15) * (size / 9.0)
        x = (plane[..., 0] % size).astype(np.float32)
        y = (plane[..., 1] % size).astype(np.float32)
        wrapped = np.pad(noise, ((0, 1), (0, 1)), mode="wrap")
        value = cv2.remap(wrapped, x, y, cv2.INTER_LINEAR)
        threshold = np.quantile(noise, 1 - min(self.sky.clouds, 1.0))
        soft = np.clip((value - threshold + 0.5) / 1.6, 0, 1)
        return soft * soft * (3 - 2 * soft)


def sky_light(sky: Sky) -> SkyLight:
    """The table of a sky, kept for the last few skies asked for."""
    vectors = (sky.sun_direction, sky.sun, sky.zenith, sky.horizon)
    numbers = np.concatenate([np.asarray(vector, np.float64).ravel() for vector in vectors])
    return _cached(numbers.tobytes(), sky.sun_radius, sky.clouds, sky.seed)


@lru_cache(maxsize=4)
def _cached(numbers: bytes, sun_radius: float, clouds: float, seed: int) -> SkyLight:
    sun_direction, sun, zenith, horizon = np.frombuffer(numbers).reshape(4, 3)
    return SkyLight(Sky(sun_direction, sun, zenith, horizon, sun_radius, clouds, seed))


# Light that reaches surfaces: sun, sky, and one bounce off what the sky is hidden by, filtered.
#
# The filter is an a-trous one (Dammertz et al., "Edge-avoiding a-trous wavelet transform for fast
# global illumination filtering", 2010) on the light alone, colours and textures left out of it;
# separable, with weights from normals and from distance to one another's planes, so that nothing is
# blurred across edges.

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
"""Exponent of the cosine between normals; a power of two."""
LEAST_SUPPORT = np.float32(0.9)
"""Sum of the weights of the four neighbours, each at most 1/2, below which a point is alone."""


@dataclass(frozen=True)
class Light:
    """What arrives at N points."""

    sun: Float32Array  # (N,) share of the sun's disc that is seen
    sky: Float32Array  # (N, 3) irradiance of everything else, divided by pi


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
