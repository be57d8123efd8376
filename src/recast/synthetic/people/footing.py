"""Where one can walk or ride: how high the ground is, and what stands on it."""

from __future__ import annotations

import numpy as np
import shapely
from numpy.typing import NDArray

from recast.synthetic.surface import Surface

Array = NDArray[np.float64]

_SLICES = (0.35, 0.9, 1.5)
"""Heights at which the street is cut: what is met there is in a person's way."""
_STEP = 0.4
"""Metres above the road below which something is ground."""


class Footing:
    """The street's triangles, asked for their height and for what stands in the way."""

    def __init__(self, surface: Surface) -> None:
        corners = surface.vertices[surface.faces]
        low, high = corners[..., 2].min(axis=1), corners[..., 2].max(axis=1)
        flat = corners[(high < _STEP) & (low > -_STEP)]
        turn = _cross(flat[:, 1] - flat[:, 0], flat[:, 2] - flat[:, 0])
        self._ground, self._turn = flat[turn > 1e-9], turn[turn > 1e-9]
        self._low = self._ground[..., :2].min(axis=1)
        self._high = self._ground[..., :2].max(axis=1)
        cuts = [_cut(corners[(low < z) & (high > z)], z) for z in _SLICES]
        self._walls = shapely.STRtree(shapely.linestrings(np.concatenate(cuts)))

    def heights(self, points: Array) -> Array:
        """Height (N,) of the highest ground under points (N, 2); NaN where there is none."""
        near = np.all((self._low <= points.max(axis=0)) & (self._high >= points.min(axis=0)), 1)
        a, b, c = np.moveaxis(self._ground[near], 1, 0)
        if not len(a):
            return np.full(len(points), np.nan)
        turn, place = self._turn[near], points[:, None]
        # Barycentric weights (N, triangles) of the corners.
        u = _cross(c[:, :2] - b[:, :2], place - b[:, :2]) / turn
        v = _cross(a[:, :2] - c[:, :2], place - c[:, :2]) / turn
        w = 1 - u - v
        z = u * a[:, 2] + v * b[:, 2] + w * c[:, 2]
        inside = (u >= -1e-9) & (v >= -1e-9) & (w >= -1e-9)
        highest = np.where(inside, z, -np.inf).max(axis=1)
        return np.where(np.isfinite(highest), highest, np.nan)

    def blocked(self, points: Array, room: float) -> bool:
        """Whether anything stands within `room` metres of a way along points (N, 2)."""
        way = shapely.linestrings(points)
        return len(self._walls.query(way, predicate="dwithin", distance=room)) > 0


def _cross(a: Array, b: Array) -> Array:
    turn: Array = a[..., 0] * b[..., 1] - a[..., 1] * b[..., 0]
    return turn


def _cut(triangles: Array, z: float) -> Array:
    """Segments (N, 2, 2) in which triangles (N, 3, 3) that reach above and below z meet it."""
    above = triangles[..., 2] > z
    # The corner that is alone on its side, and the two others.
    alone = np.where(above.sum(axis=1) == 1, above.argmax(axis=1), (~above).argmax(axis=1))
    rows = np.arange(len(triangles))
    apex = triangles[rows, alone]
    ends = []
    for k in (1, 2):
        other = triangles[rows, (alone + k) % 3]
        share = (z - apex[:, 2]) / (other[:, 2] - apex[:, 2])
        ends.append(apex[:, :2] + share[:, None] * (other[:, :2] - apex[:, :2]))
    return np.stack(ends, axis=1)
