"""The sky as a light: radiance from every direction, sun glow, clouds, haze, ground far away."""

from __future__ import annotations

from functools import lru_cache

import cv2
import numpy as np

from recast.arrays import Array
from recast.synthetic.rendering.patterns import gather_image, spectral_noise
from recast.synthetic.rendering.rays import Float32Array, outer
from recast.synthetic.rendering.surface_points import LUMINANCE
from recast.synthetic.world import Sky

HAZE_LENGTH = 1800.0
"""Metres after which haze leaves 1/e of a surface's light."""
GROUND_ALBEDO = np.array([0.17, 0.17, 0.14])
"""Of the plain beyond the end of the scene."""
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
