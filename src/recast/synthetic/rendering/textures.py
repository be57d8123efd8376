"""Procedural textures on surfaces, in the surface's own frame, no finer than a pixel.

All patterns lie in one image: a row of mip levels for each, so that a single `cv2.remap` serves all
materials at once.
"""

from __future__ import annotations

from functools import lru_cache

import cv2
import numpy as np
from numpy.typing import NDArray

from recast.synthetic.materials import MATERIALS
from recast.synthetic.rendering.embree import Float32Array
from recast.synthetic.rendering.image_lookup import gather_image
from recast.synthetic.rendering.patterns import SIZE, Pattern, coarse_patterns, fine_patterns
from recast.synthetic.rendering.surface_points import SurfacePoints
from recast.synthetic.rendering.vectors import dot, rows, scale

LEVELS = 9
_SCALE = np.float32(100.0)
_LEVEL_SIZE = (SIZE >> np.arange(LEVELS)).astype(np.float32)
# A pixel of margin on both sides of each level repeats what lies across the seam.
_LEVEL_START = np.concatenate([[0], np.cumsum(_LEVEL_SIZE[:-1] + 2)]).astype(np.float32) + 1


class Atlas:
    """Some patterns with their mip levels, by material.

    Args:
        patterns: by `Material.texture`.
    """

    def __init__(self, patterns: dict[str, Pattern]) -> None:
        names = list(patterns)
        self.row = np.array(
            [names.index(m.texture) if m.texture in patterns else -1 for m in MATERIALS], np.int64
        )
        self._frequency = np.array([1 / p.metres for p in patterns.values()], np.float32)
        self._top = (np.arange(len(patterns)) * (SIZE + 2) + 0.5).astype(np.float32)
        width = int(_LEVEL_START[-1] + _LEVEL_SIZE[-1] + 1)
        self.image = np.zeros((len(patterns) * (SIZE + 2), width, 3), np.uint8)
        for row, pattern in enumerate(patterns.values()):
            level = pattern.image / pattern.image.mean(axis=(0, 1))
            for start in _LEVEL_START.astype(int):
                padded = np.pad(level, ((1, 1), (1, 1), (0, 0)), mode="wrap")
                top = row * (SIZE + 2)
                height, wide = padded.shape[:2]
                self.image[top : top + height, start - 1 : start - 1 + wide] = np.clip(
                    padded * _SCALE + 0.5, 0, 255
                ).astype(np.uint8)
                half = (max(level.shape[1] // 2, 1), max(level.shape[0] // 2, 1))
                level = cv2.resize(level, half, interpolation=cv2.INTER_AREA)

    def factors(
        self, row: NDArray[np.int64], u: Float32Array, v: Float32Array, footprint: Float32Array
    ) -> Float32Array:
        """Factors (N, 3) of patterns `row` (N,) at u, v (N,) metres, no finer than `footprint`."""
        periods = self._frequency[row]
        u, v = u * periods, v * periods
        u -= np.floor(u)
        v -= np.floor(v)
        level = np.log2(np.maximum(footprint * periods * np.float32(SIZE), 1))
        level = np.minimum(level, np.float32(LEVELS - 1.001))
        finer_level = np.floor(level)
        blend = level - finer_level
        below = finer_level.astype(np.int64)
        top = self._top[row]
        finer = self._level(top, u, v, below)
        coarser = self._level(top, u, v, below + 1)
        coarser -= finer
        finer += scale(coarser, blend)
        return finer

    def _level(
        self, top: Float32Array, u: Float32Array, v: Float32Array, level: NDArray[np.int64]
    ) -> Float32Array:
        size = _LEVEL_SIZE[level]
        x, y = u * size, v * size
        x += _LEVEL_START[level] - np.float32(0.5)
        y += top
        return gather_image(self.image, x, y)[: len(top)] * (1 / _SCALE)


@lru_cache(maxsize=1)
def _atlases() -> tuple[Atlas, Atlas]:
    return Atlas(fine_patterns()), Atlas(coarse_patterns())


def textured(points: SurfacePoints, pixel_angle: float) -> Float32Array:
    """Diffuse colours (N, 3) with their textures.

    Args:
        pixel_angle: radians between neighbouring rays.
    """
    colour = points.colour.copy()
    fine, coarse = _atlases()
    index = np.flatnonzero(fine.row[points.material] >= 0)
    if not len(index):
        return colour
    u, v = surface_coordinates(*points.local(index))
    # A pixel covers more of a surface seen at an angle; the mean of both axes of the ellipse.
    facing = rows(-dot(points.view, points.flat), index)
    footprint = rows(points.distance, index) * np.float32(pixel_angle)
    footprint /= np.sqrt(np.maximum(facing, np.float32(0.02)))
    material = rows(points.material, index)
    factors = fine.factors(fine.row[material], u, v, footprint)
    wide = np.flatnonzero(coarse.row[material] >= 0)
    stains = coarse.factors(coarse.row[material[wide]], u[wide], v[wide], footprint[wide])
    factors[wide] = rows(factors, wide) * stains
    factors *= rows(colour, index)
    colour[index] = factors
    return np.minimum(colour, np.float32(0.95), out=colour)


def surface_coordinates(
    position: Float32Array, flat: Float32Array
) -> tuple[Float32Array, Float32Array]:
    """Metres along a surface, (N,) and (N,): level and up the slope; x and y where it is level.

    Args:
        position, flat: (N, 3) in the frame of the surface's object.
    """
    level = np.sqrt(flat[:, 0] ** 2 + flat[:, 1] ** 2)
    floor = level < np.float32(0.4)
    safe = np.maximum(level, np.float32(0.1))
    along_x, along_y = -flat[:, 1] / safe, flat[:, 0] / safe
    u = position[:, 0] * along_x + position[:, 1] * along_y
    v = position[:, 2] * level
    v -= flat[:, 2] * (position[:, 0] * along_y - position[:, 1] * along_x)
    return np.where(floor, position[:, 0], u), np.where(floor, position[:, 1], v)
