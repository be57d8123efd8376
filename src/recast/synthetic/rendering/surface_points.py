"""Seamless procedural patterns: what asphalt, grass, brick and the like multiply colours by.

Each pattern is an image of factors about 1, drawn once from a fixed seed; its horizontal axis runs
along the ground on walls, its rows upwards.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, fields, replace
from functools import cached_property, lru_cache
from types import SimpleNamespace
from typing import Any

import cv2
import numpy as np
from numpy.typing import NDArray

from recast.geometry import colour
from recast.synthetic.rendering import compiled
from recast.synthetic.rendering.rays import (
    SKY,
    STREET,
    Float32Array,
    Hits,
    PosedScene,
    dot,
    normalise,
    rows,
    scale,
    scaled,
)
from recast.synthetic.surface import MATERIALS

SIZE = 512
"""Pixels of a pattern's side."""


def spectral_noise(
    size: int,
    rng: np.random.Generator,
    *,
    slope: float = 1.0,
    low: float = 1.0,
    high: float = np.inf,
    stretch: float = 1.0,
) -> Float32Array:
    """Noise (size, size) of mean 0 and standard deviation 1 that repeats without a seam.

    White noise filtered in the Fourier domain, whatever repeats there being periodic here.

    Args:
        size: pixels of a period.
        rng: the only source of randomness.
        slope: amplitude falls as frequency ** -slope.
        low, high: band of frequencies kept, in cycles a period.
        stretch: above 1, streaks along the vertical axis.
    """
    spectrum = np.fft.rfft2(rng.standard_normal((size, size)))
    vertical = np.fft.fftfreq(size, 1 / size)[:, None] * stretch
    frequency = np.hypot(vertical, np.fft.rfftfreq(size, 1 / size)[None])
    keep = (frequency >= low) & (frequency <= high)
    spectrum *= np.where(keep, np.maximum(frequency, 1e-6) ** -slope, 0.0)
    noise = np.fft.irfft2(spectrum, s=(size, size))
    return ((noise - noise.mean()) / noise.std()).astype(np.float32)


@dataclass(frozen=True)
class Pattern:
    """One period of a pattern."""

    metres: float  # side of the period
    image: Float32Array  # (SIZE, SIZE, 3) factors


def fine_patterns() -> dict[str, Pattern]:
    """The detail of each texture of `recast.synthetic.surface`."""
    makers: dict[str, tuple[float, Callable[[np.random.Generator], Float32Array]]] = {
        "asphalt": (3.0, _asphalt),
        "concrete": (2.4, _concrete),
        "grass": (4.0, _grass),
        "soil": (4.0, _soil),
        "foliage": (2.4, _foliage),
        "bark": (1.6, _bark),
        "brick": (1.92, _brick),
        "plaster": (3.0, _plaster),
        "tiles": (2.4, _roof_tiles),
        "corrugated": (2.4, _corrugated),
        "wood": (1.92, _wood),
        "fabric": (0.4, _fabric),
    }
    return {
        name: Pattern(metres, make(np.random.default_rng([i, 0x7E47])))
        for i, (name, (metres, make)) in enumerate(makers.items())
    }


def coarse_patterns() -> dict[str, Pattern]:
    """Stains and patches of some textures, many metres wide, that hide the period of the detail."""
    makers: dict[str, tuple[float, Callable[[np.random.Generator], Float32Array]]] = {
        "asphalt": (29.0, _road_patches),
        "concrete": (17.0, lambda rng: _stains(rng, 0.07)),
        "grass": (37.0, _meadow),
        "soil": (31.0, lambda rng: _stains(rng, 0.16)),
        "brick": (13.0, lambda rng: _stains(rng, 0.10)),
        "plaster": (11.0, lambda rng: _stains(rng, 0.06)),
        "foliage": (7.0, lambda rng: _stains(rng, 0.18)),
    }
    return {
        name: Pattern(metres, make(np.random.default_rng([i, 0xC0A5])))
        for i, (name, (metres, make)) in enumerate(makers.items())
    }


def _grey(factor: Float32Array) -> Float32Array:
    return np.repeat(factor[..., None], 3, axis=2).astype(np.float32)


def _asphalt(rng: np.random.Generator) -> Float32Array:
    grain = spectral_noise(SIZE, rng, slope=0.15, low=30)
    clumps = spectral_noise(SIZE, rng, slope=0.6, low=4, high=60)
    stones = np.where(grain > 1.9, 0.5, 0.0)
    return _grey(1 + 0.16 * grain + 0.06 * clumps + stones)


def _concrete(rng: np.random.Generator) -> Float32Array:
    factor = 1 + 0.05 * spectral_noise(SIZE, rng, slope=0.3, low=8)
    factor += 0.04 * spectral_noise(SIZE, rng, slope=1.2)
    at = np.arange(SIZE)
    slab = SIZE // 2
    tone = np.repeat(np.repeat(rng.normal(1, 0.035, (2, 2)), slab, 0), slab, 1)
    factor *= tone
    joint = (at % slab) < 4
    factor[joint] *= 0.62
    factor[:, joint] *= 0.62
    return _grey(factor)


def _grass(rng: np.random.Generator) -> Float32Array:
    blades = spectral_noise(SIZE, rng, slope=0.5, low=12)
    tufts = spectral_noise(SIZE, rng, slope=1.0, low=3, high=40)
    factor = _grey(np.exp(0.30 * blades + 0.18 * tufts - 0.06))
    dry = 0.12 * spectral_noise(SIZE, rng, slope=0.9, low=2)
    factor[..., 0] *= 1 + dry
    factor[..., 2] *= 1 - 0.4 * dry
    return factor


def _soil(rng: np.random.Generator) -> Float32Array:
    lumps = spectral_noise(SIZE, rng, slope=0.8, low=4)
    return _grey(np.exp(0.25 * lumps - 0.03))


def _foliage(rng: np.random.Generator) -> Float32Array:
    leaves = spectral_noise(SIZE, rng, slope=0.3, low=10, high=64)
    gaps = spectral_noise(SIZE, rng, slope=0.6, low=3, high=24)
    factor = _grey(np.exp(0.42 * leaves + 0.3 * gaps - 0.12))
    young = 0.12 * spectral_noise(SIZE, rng, slope=0.5, low=6)
    factor[..., 0] *= 1 + young
    factor[..., 2] *= 1 - 0.5 * young
    return factor


def _bark(rng: np.random.Generator) -> Float32Array:
    ridges = spectral_noise(SIZE, rng, slope=0.6, low=6, stretch=5.0)
    return _grey(np.exp(0.35 * ridges - 0.06))


def _brick(rng: np.random.Generator) -> Float32Array:
    rows, columns = 24, 8  # 8 cm courses, 24 cm bricks, mortar included
    at = (np.arange(SIZE) + 0.5) / SIZE
    course = (at * rows).astype(int)
    along = at[None] * columns + 0.5 * (course[:, None] % 2)
    brick = along.astype(int) % columns
    light = np.exp(rng.normal(0, 0.16, (rows, columns)))
    warm = rng.normal(0, 0.06, (rows, columns))
    factor = _grey(light[course[:, None], brick])
    factor[..., 0] *= 1 + warm[course[:, None], brick]
    factor[..., 2] *= 1 - warm[course[:, None], brick]
    factor *= 1 + 0.08 * spectral_noise(SIZE, rng, slope=0.4, low=10)[..., None]
    mortar = ((at * rows) % 1 < 0.13)[:, None] | ((along % 1) < 0.045)
    factor[mortar] = [1.35, 1.75, 1.95]
    return factor


def _plaster(rng: np.random.Generator) -> Float32Array:
    rough = spectral_noise(SIZE, rng, slope=0.3, low=12)
    runs = spectral_noise(SIZE, rng, slope=1.1, stretch=0.25)
    return _grey(1 + 0.035 * rough + 0.025 * runs)


def _roof_tiles(rng: np.random.Generator) -> Float32Array:
    rows, columns = 8, 12  # 30 cm courses, 20 cm tiles
    at = (np.arange(SIZE) + 0.5) / SIZE
    course = (at * rows).astype(int)
    along = at[None] * columns + 0.5 * (course[:, None] % 2)
    tone = np.exp(rng.normal(0, 0.10, (rows, columns)))
    factor = tone[course[:, None], along.astype(int) % columns]
    rise = (at * rows) % 1
    factor = factor * (1.08 - 0.16 * rise[:, None])
    factor *= np.where(rise < 0.1, 0.45, 1.0)[:, None] * np.where(along % 1 < 0.06, 0.7, 1.0)
    return _grey(factor * (1 + 0.08 * spectral_noise(SIZE, rng, slope=0.5, low=6)))


def _corrugated(rng: np.random.Generator) -> Float32Array:
    at = (np.arange(SIZE) + 0.5) / SIZE
    ribs = np.sin(2 * np.pi * 12 * at)  # every 20 cm
    dirt = spectral_noise(SIZE, rng, slope=1.0, stretch=0.2)
    return _grey(1 + 0.20 * ribs[None] + 0.05 * dirt)


def _wood(rng: np.random.Generator) -> Float32Array:
    boards = 12  # 16 cm each
    at = (np.arange(SIZE) + 0.5) / SIZE
    board = (at * boards).astype(int)
    tone = np.exp(rng.normal(0, 0.12, boards))[board]
    grain = spectral_noise(SIZE, rng, slope=0.5, low=8, stretch=14.0)
    factor = tone[None] * (1 + 0.13 * grain)
    factor[:, (at * boards) % 1 < 0.05] *= 0.4
    return _grey(factor)


def _fabric(rng: np.random.Generator) -> Float32Array:
    return _grey(1 + 0.12 * spectral_noise(SIZE, rng, slope=0.2, low=40))


def _road_patches(rng: np.random.Generator) -> Float32Array:
    factor = 1 + 0.07 * spectral_noise(SIZE, rng, slope=1.2, low=2)
    for _ in range(5):  # trenches filled again
        height, width = rng.integers(15, 80, 2)
        y, x = rng.integers(0, SIZE, 2)
        rows, columns = (y + np.arange(height)) % SIZE, (x + np.arange(width)) % SIZE
        factor[np.ix_(rows, columns)] *= rng.choice([0.78, 0.86, 1.12])
    cracks = np.abs(spectral_noise(SIZE, rng, slope=1.3, low=3, high=80)) < 0.012
    calm = spectral_noise(SIZE, rng, slope=1.5, low=2) > 0.3
    factor[cracks & calm] *= 0.6
    return _grey(factor)


def _meadow(rng: np.random.Generator) -> Float32Array:
    factor = _grey(np.exp(0.14 * spectral_noise(SIZE, rng, slope=1.1, low=2)))
    dry = spectral_noise(SIZE, rng, slope=1.2, low=2)
    factor[..., 0] *= 1 + 0.16 * dry
    factor[..., 2] *= 1 - 0.08 * dry
    return factor


def _stains(rng: np.random.Generator, strength: float) -> Float32Array:
    return _grey(np.exp(strength * spectral_noise(SIZE, rng, slope=1.3)))


def gather_image(image: NDArray, x: Float32Array, y: Float32Array) -> NDArray:
    """Bilinear samples (at least N, channels) of an image at pixel coordinates x, y (N,).

    Pixel centres at whole numbers. The points are folded into a grid, as `cv2.remap` takes no side
    longer than 32767; the result is padded to full rows of that grid.
    """
    row = 1024
    count = len(x)
    height = -(-count // row)
    if not count:
        return np.zeros((0, image.shape[-1]), image.dtype)
    places = np.zeros((2, height * row), np.float32)
    places[0, :count], places[1, :count] = x, y
    columns, rows = places.reshape(2, height, row)
    samples = cv2.remap(image, columns, rows, cv2.INTER_LINEAR, borderMode=cv2.BORDER_REPLICATE)
    return samples.reshape(height * row, -1)


# What lies where rays met the scene: position, normals, colour, material and texture.
#
# Procedural textures lie in the surface's own frame, no finer than a pixel. All patterns lie in one
# image: a row of mip levels for each, so that a single `cv2.remap` serves all materials at once.

LUMINANCE = np.array(colour.LUMINANCE, np.float32)
"""Luminance of linear RGB, ITU-R BT.709."""
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
    """N points on surfaces; arrays of length N, world frame."""

    position: Float32Array  # (N, 3) float32
    view: Float32Array  # (N, 3) unit direction of the ray that came here
    distance: Float32Array  # (N,) distance along that ray
    flat: Float32Array  # (N, 3) unit normal of the face, turned to the viewer
    normal: Float32Array  # (N, 3) unit shading normal, turned to the viewer
    colour: Float32Array  # (N, 3) diffuse colour, before any texture
    material: NDArray[np.uint8]  # (N,) index into `MATERIALS`
    instance: NDArray[np.uint16]  # (N,) instance, see `Hits`
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
        """Cosine (N,) of the angle between viewer and shading normal."""
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
