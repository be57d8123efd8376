"""Curves through control points with rounded corners."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

Array = NDArray[np.float64]


@dataclass(frozen=True)
class Profile:
    """A height over a station, piecewise linear at a few millimetres.

    Attributes:
        stations: (N,) increasing, metres.
        heights: (N,) metres.
    """

    stations: Array
    heights: Array

    @classmethod
    def rounded(cls, corners: Sequence[tuple[float, float, float]], steps: int = 12) -> Profile:
        """Each inner corner (station, height, radius) becomes a quadratic Bezier curve.

        The curve starts `radius` metres before the corner and ends as far after it, at most half
        of the straight piece.
        """
        points = np.array([corner[:2] for corner in corners], np.float64)
        t = np.linspace(0, 1, steps)[:, None]
        pieces = [points[:1]]
        for k in range(1, len(points) - 1):
            before, after = points[k - 1] - points[k], points[k + 1] - points[k]
            ends = []
            for arm in (before, after):
                length = float(np.linalg.norm(arm))
                ends.append(points[k] + arm * min(corners[k][2] / max(length, 1e-9), 0.5))
            a, b = ends
            pieces.append((1 - t) ** 2 * a + 2 * t * (1 - t) * points[k] + t**2 * b)
        curve = np.concatenate([*pieces, points[-1:]])
        keep = np.concatenate([[True], np.diff(np.maximum.accumulate(curve[:, 0])) > 1e-6])
        return cls(curve[keep, 0], curve[keep, 1])

    def __call__(self, station: Array) -> Array:
        """Heights at stations of any shape."""
        return np.interp(station, self.stations, self.heights)

    def slope(self, station: Array) -> Array:
        """Rise per metre, over 2 cm."""
        return (self(station + 0.01) - self(station - 0.01)) / 0.02

    def spread(self, start: float, end: float, count: int, focus: float = 1.0) -> Array:
        """(count,) stations from start to end, closer together where the curve is steep.

        Args:
            start, end: metres.
            count: of stations.
            focus: 0 spaces evenly along the station, 1 along the curve.
        """
        dense = np.linspace(start, end, 800)
        rise = np.gradient(self(dense), dense)
        path = np.concatenate([[0.0], np.cumsum(np.sqrt(1 + focus * rise[1:] ** 2))])
        return np.interp(np.linspace(0, path[-1], count), path, dense)
