"""Seamless noise for textures and clouds."""

from __future__ import annotations

import numpy as np

from recast.synthetic.rendering.embree import Float32Array


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
