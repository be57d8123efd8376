"""What lies where rays met the scene: position, normals, colour, material and texture.

Procedural textures lie in the surface's own frame, no finer than a pixel. All patterns lie in one
image: a row of mip levels for each, so that a single `cv2.remap` serves all materials at once.
"""

from __future__ import annotations

from dataclasses import dataclass, fields, replace
from functools import cached_property, lru_cache
from types import SimpleNamespace
from typing import Any

import cv2
import numpy as np
from numpy.typing import NDArray

from recast.geometry import colour
from recast.synthetic.rendering import compiled
from recast.synthetic.rendering.patterns import (
    SIZE,
    Pattern,
    coarse_patterns,
    fine_patterns,
    gather_image,
)
from recast.synthetic.rendering.ray_scene import SKY, STREET, Hits, PosedScene
from recast.synthetic.rendering.rays import Float32Array, dot, normalise, rows, scale, scaled
from recast.synthetic.surface import MATERIALS

LUMINANCE = np.array(colour.LUMINANCE, np.float32)
"""Of linear RGB, ITU-R BT.709."""
LEVELS = 9
_SCALE = np.float32(100.0)
_LEVEL_SIZE = (SIZE >> np.arange(LEVELS)).astype(np.float32)
# A pixel of margin on both sides of each level repeats what lies across the seam.
_LEVEL_START = np.concatenate([[0], np.cumsum(_LEVEL_SIZE[:-1] + 2)]).astype(np.float32) + 1


_FLOATS, _FLAGS = ("specular", "roughness", "emission", "lidar"), ("metallic", "retroreflective")
TABLE = SimpleNamespace(
    **{
        name: np.array([getattr(material, name) for material in MATERIALS], dtype)
        for names, dtype in ((_FLOATS, np.float32), (_FLAGS, np.bool_))
        for name in names
    }
)
"""The fields of `MATERIALS` as arrays over material indices."""


@dataclass
class SurfacePoints:
    """N points on surfaces; arrays of length N, world frame.

    Attributes:
        position: (N, 3) float32.
        view: (N, 3) unit direction of the ray that came here.
        distance: (N,) distance along that ray.
        flat: (N, 3) unit normal of the face, turned to the viewer.
        normal: (N, 3) unit shading normal, turned to the viewer.
        colour: (N, 3) diffuse colour, before any texture.
        material: (N,) index into `MATERIALS`.
        instance: (N,) instance, see `Hits`.
    """

    position: Float32Array
    view: Float32Array
    distance: Float32Array
    flat: Float32Array
    normal: Float32Array
    colour: Float32Array
    material: NDArray[np.uint8]
    instance: NDArray[np.uint16]
    posed: PosedScene

    @cached_property
    def origin(self) -> Float32Array:
        """Where rays that leave the surface start: lifted off it by its rounding error."""
        lift = np.float32(2e-3) + np.float32(3e-5) * self.distance
        origin = scaled(self.flat, lift)
        origin += self.position
        return origin

    @cached_property
    def cosine(self) -> Float32Array:
        """Of the angle (N,) between viewer and shading normal."""
        return np.clip(-dot(self.view, self.normal), 0, 1)

    def local(self, index: NDArray[np.int64]) -> tuple[Float32Array, Float32Array]:
        """Position and flat normal (M, 3) of some, in the frame of the surface they belong to."""
        position, flat = rows(self.position, index), rows(self.flat, index)
        instance = rows(self.instance, index)
        moved = np.flatnonzero(instance != STREET)
        if len(moved):
            which = instance[moved]
            rotation = self.posed.rotation[which]
            shifted = position[moved] - self.posed.translation[which]
            position[moved] = np.einsum("ij,ijk->ik", shifted, rotation)
            flat[moved] = np.einsum("ij,ijk->ik", flat[moved], rotation)
        return position, flat

    def take(self, index: NDArray[np.int64]) -> SurfacePoints:
        """Some of the points."""
        names = [field.name for field in fields(self) if field.name != "posed"]
        taken: Any = {name: rows(getattr(self, name), index) for name in names}
        return replace(self, **taken)

    def __len__(self) -> int:
        return len(self.position)


def surface_points(
    posed: PosedScene,
    origins: Float32Array,
    directions: Float32Array,
    hits: Hits,
    rays: NDArray[np.int64] | None = None,
    *,
    smooth: bool = True,
) -> tuple[NDArray[np.int64], SurfacePoints]:
    """The points that rays met, and the indices of those rays.

    Args:
        origins, directions: (N, 3) origins and directions of the rays cast.
        hits: what they met.
        rays: indices of the rays to take; all that met something when None.
        smooth: False takes the faces' own normals for shading: enough where nobody looks.
    """
    if rays is None:
        rays = np.flatnonzero(hits.instance != SKY)
    attributes = posed.scene.attributes
    instance = rows(hits.instance, rays)
    face = rows(hits.face, rays) + rows(attributes.first, instance)
    distance = rows(hits.distance, rays)
    colour, material = rows(attributes.colours, face), rows(attributes.materials, face)
    found = compiled.surface(rays, origins, directions, hits, instance, face, posed, smooth)
    if found is not None:
        position, view, flat, normal = found
        return rays, SurfacePoints(
            position, view, distance, flat, normal, colour, material, instance, posed
        )
    view = rows(directions, rays)
    moved = np.flatnonzero(instance != STREET)
    rotation = posed.rotation[instance[moved]]
    flat = rows(attributes.flat_normals, face)
    flat[moved] = _rotated(rotation, flat[moved])
    # Both sides of a face are seen; its normal looks at the viewer.
    side = np.where(dot(view, flat) > 0, np.float32(-1), np.float32(1))
    scale(flat, side)
    normal = flat
    if smooth:
        u, v = rows(hits.u, rays), rows(hits.v, rays)
        corners = rows(attributes.corner_normals, face)
        normal = scaled(corners[:, 0], 1 - u - v)
        normal += scaled(corners[:, 1], u)
        normal += scaled(corners[:, 2], v)
        normal[moved] = _rotated(rotation, normal[moved])
        scale(normal, side)
        # Near an outline a shading normal may look away: bend it back to a right angle.
        normal -= scaled(view, np.maximum(dot(view, normal), 0))
        normal += flat * np.float32(1e-4)
        normalise(normal)
    position = scaled(view, distance)
    position += rows(origins, rays)
    return rays, SurfacePoints(
        position, view, distance, flat, normal, colour, material, instance, posed
    )


def _rotated(rotations: Float32Array, vectors: Float32Array) -> Float32Array:
    """Vectors (N, 3), each turned by its own rotation (N, 3, 3)."""
    return np.stack([dot(rotations[:, k], vectors) for k in range(3)], axis=1)


class Atlas:
    """Some patterns with their mip levels, by material.

    Args:
        patterns: patterns by `Material.texture`.
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
                quantised = np.clip(padded * _SCALE + 0.5, 0, 255).astype(np.uint8)
                self.image[top : top + height, start - 1 : start - 1 + wide] = quantised
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
        position, flat: (N, 3) positions and face normals in the frame of the surface's object.
    """
    level = np.sqrt(flat[:, 0] ** 2 + flat[:, 1] ** 2)
    floor = level < np.float32(0.4)
    safe = np.maximum(level, np.float32(0.1))
    along_x, along_y = -flat[:, 1] / safe, flat[:, 0] / safe
    u = position[:, 0] * along_x + position[:, 1] * along_y
    v = position[:, 2] * level
    v -= flat[:, 2] * (position[:, 0] * along_y - position[:, 1] * along_x)
    return np.where(floor, position[:, 0], u), np.where(floor, position[:, 1], v)
