"""Seamless procedural patterns: what asphalt, grass, brick and the like multiply colours by.

Each pattern is an image of factors about 1, drawn once from a fixed seed; its horizontal axis runs
along the ground on walls, its rows upwards.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

import cv2
import numpy as np
from numpy.typing import NDArray

from recast.synthetic.rendering.rays import Float32Array

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
    """One period of a pattern.

    Attributes:
        metres: side of the period.
        image: (SIZE, SIZE, 3) factors.
    """

    metres: float
    image: Float32Array


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
