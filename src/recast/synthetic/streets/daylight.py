"""Sun and sky of a scene."""

from __future__ import annotations

import numpy as np
from numpy.random import Generator

from recast.synthetic.world import Sky


def daylight(rng: Generator, elevation: tuple[float, float] = (25.0, 60.0)) -> Sky:
    """A sky drawn from fair to overcast; the lower the sun, the warmer and weaker its light.

    Args:
        rng: source of the draw.
        elevation: degrees between which the sun stands.
    """
    azimuth = rng.uniform(0.0, 2 * np.pi)
    high = np.deg2rad(rng.uniform(*elevation))
    clouds = float(rng.choice([rng.uniform(0.05, 0.35), rng.uniform(0.35, 0.75)], p=[0.65, 0.35]))
    haze = rng.uniform(0.0, 1.0)
    direction = np.array(
        [np.cos(azimuth) * np.cos(high), np.sin(azimuth) * np.cos(high), np.sin(high)]
    )
    low = np.exp(-np.sin(high) / 0.35)  # path through the air
    strength = (1 - 0.55 * clouds**2) * (1 - 0.15 * haze)
    sun = strength * 5.0 * np.array([1.0, 1.0 - 0.16 * low, 0.94 - 0.42 * low]) * (1 - 0.3 * low)
    grey = np.array([0.62, 0.66, 0.72])
    clear = np.array([0.23, 0.36, 0.62])
    zenith = (1 - 0.6 * clouds) * clear + 0.6 * clouds * grey
    pale = np.array([0.66, 0.76, 0.88])
    horizon = (1 - 0.5 * haze) * pale + 0.5 * haze * np.array([0.85, 0.85, 0.84])
    return Sky(
        sun_direction=direction,
        sun=sun,
        zenith=zenith,
        horizon=horizon,
        sun_radius=float(0.006 + 0.03 * clouds),
        clouds=clouds,
        seed=int(rng.integers(2**31)),
    )
