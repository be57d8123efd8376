"""How fast a driver goes along a path: slower in bends, never quite even."""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property

import numpy as np
from numpy.typing import ArrayLike, NDArray
from scipy.ndimage import gaussian_filter1d

from recast.synthetic.lane_path import LanePath

Array = NDArray[np.float64]

LATERAL_LIMIT = 2.0
"""m/s^2 that no driver exceeds; profiles aim at less, for what smoothing adds."""
_LATERAL_AIM = 1.6
_SPEEDING_UP, _SLOWING_DOWN = 1.0, 1.3
_SPACING = 0.5
_SMOOTHING = 2.0
_UNEVENNESS = 0.05
_FINER = 20


@dataclass(frozen=True)
class SpeedProfile:
    """Speed by place.

    Attributes:
        s: (N,) metres along the path, evenly spaced from 0.
        speed: (N,) m/s, positive.
    """

    s: Array
    speed: Array

    def at(self, s: ArrayLike) -> Array:
        """Speeds (...) at arc lengths (...)."""
        speed: Array = np.interp(np.asarray(s, np.float64), self.s, self.speed)
        return speed

    @cached_property
    def _clock(self) -> tuple[Array, Array]:
        """Places and the seconds at which a free drive from the path's start reaches them."""
        place = np.linspace(self.s[0], self.s[-1], _FINER * (len(self.s) - 1) + 1)
        slowness = 1 / self.at(place)
        spent = np.cumsum(np.diff(place) * (slowness[:-1] + slowness[1:]) / 2)
        return place, np.concatenate([[0.0], spent])

    def drive(self, start: float, seconds: ArrayLike) -> Array:
        """Arc lengths (...) reached `seconds` (...) after `start`; seconds may be negative.

        Beyond both ends of the path, the speed there is kept.
        """
        place, clock = self._clock
        times = np.interp(start, place, clock) + np.asarray(seconds, np.float64)
        reached = np.interp(times, clock, place)
        reached = reached + np.minimum(times, 0.0) * self.speed[0]
        driven: Array = reached + np.maximum(times - clock[-1], 0.0) * self.speed[-1]
        return driven


def speed_profile(path: LanePath, cruise: float, rng: np.random.Generator) -> SpeedProfile:
    """A profile with lateral acceleration within 2 m/s^2 and gentle braking ahead of bends.

    Args:
        cruise: m/s on a straight free road; wavers by 5 %.
    """
    s = np.linspace(0.0, path.length, max(2, int(np.ceil(path.length / _SPACING)) + 1))
    step = s[1] - s[0]
    phase, wavelength = rng.uniform(0, 2 * np.pi), rng.uniform(60.0, 110.0)
    wanted = cruise * (1 + _UNEVENNESS * np.sin(2 * np.pi * s / wavelength + phase))
    bend = np.abs(path.curvature(s))
    square = np.minimum(wanted, np.sqrt(_LATERAL_AIM / np.maximum(bend, 1e-6))) ** 2
    for i in range(1, len(square)):
        square[i] = min(square[i], square[i - 1] + 2 * _SPEEDING_UP * step)
    for i in range(len(square) - 2, -1, -1):
        square[i] = min(square[i], square[i + 1] + 2 * _SLOWING_DOWN * step)
    speed = gaussian_filter1d(np.sqrt(square), _SMOOTHING / step, mode="nearest")
    return SpeedProfile(s, speed)
