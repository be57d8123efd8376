"""A smooth path along lanes, by arc length."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from functools import cached_property

import numpy as np
from numpy.typing import ArrayLike, NDArray
from scipy.interpolate import CubicSpline
from scipy.ndimage import gaussian_filter1d

from recast.geometry import Polyline
from recast.logs import HdMap

Array = NDArray[np.float64]

_SPACING = 0.5
_SMOOTHING = 1.5
"""Metres (standard deviation) over which corners of centrelines are rounded."""
_EXTENSION = 12.0
"""Metres added straight at both ends for the smoothing, and taken off again."""


@dataclass(frozen=True)
class LanePath:
    """A path with continuous heading and curvature.

    Attributes:
        lanes: the lanes it follows, in order.
        line: its points, 0.5 m apart.
    """

    lanes: tuple[str, ...]
    line: Polyline

    @classmethod
    def along(cls, street_map: HdMap, lanes: Sequence[str]) -> LanePath:
        """The rounded centreline of successive lanes.

        Raises:
            ValueError: the lanes hold fewer than two distinct points.
        """
        points = np.concatenate([street_map.lanes[name].centreline[:, :2] for name in lanes])
        raw = Polyline.from_points(points, min_step=0.05)
        count = int(np.ceil((raw.length + 2 * _EXTENSION) / _SPACING))
        s = np.linspace(-_EXTENSION, raw.length + _EXTENSION, count + 1)
        sigma = _SMOOTHING / (s[1] - s[0])
        smooth = gaussian_filter1d(raw.position(s), sigma, axis=0, mode="nearest")
        inside = (s >= 0) & (s <= raw.length)
        return cls(tuple(lanes), Polyline(smooth[inside]))

    @property
    def length(self) -> float:
        """Metres."""
        return self.line.length

    @cached_property
    def _spline(self) -> CubicSpline:
        return CubicSpline(self.line.arc_lengths, self.line.points)

    def position(self, s: ArrayLike) -> Array:
        """Points (..., 2) at arc lengths (...) within [0, length]."""
        points: Array = self._spline(np.asarray(s, np.float64))
        return points

    def heading(self, s: ArrayLike) -> Array:
        """Tangent heading (...), radians."""
        tangent = self._spline(np.asarray(s, np.float64), 1)
        angle: Array = np.arctan2(tangent[..., 1], tangent[..., 0])
        return angle

    def curvature(self, s: ArrayLike) -> Array:
        """Signed curvature (...), 1/m, positive to the left."""
        s = np.asarray(s, np.float64)
        (dx, dy), (ddx, ddy) = (np.moveaxis(self._spline(s, order), -1, 0) for order in (1, 2))
        bend: Array = (dx * ddy - dy * ddx) / np.hypot(dx, dy) ** 3
        return bend

    def poses(self, s: ArrayLike, wheelbase: float = 0.0) -> Array:
        """Planar poses (..., 3) of a vehicle whose middle is at s.

        Args:
            wheelbase: both axles are on the path, this many metres apart; 0 for the tangent.
        """
        s = np.asarray(s, np.float64)
        if wheelbase <= 0:
            return np.concatenate([self.position(s), self.heading(s)[..., None]], axis=-1)
        rear, front = self.position(s - wheelbase / 2), self.position(s + wheelbase / 2)
        axis = front - rear
        heading = np.arctan2(axis[..., 1], axis[..., 0])
        return np.concatenate([(rear + front) / 2, heading[..., None]], axis=-1)
