"""A road's reference line through the points of a lane's centreline, and the widths beside it."""

from __future__ import annotations

import numpy as np

from recast.arrays import Array, Int64Array
from recast.logs.hdmap import Lane

_NODES, _WEIGHTS = np.polynomial.legendre.leggauss(8)
_CLOSEST = 1e-3  # metres between points of a reference line


def apart(line: Array) -> Int64Array:
    """Indices of points that are not nearly the same as the one before; two at least."""
    kept = [0]
    for i in range(1, len(line)):
        if np.linalg.norm(line[i, :2] - line[kept[-1], :2]) >= _CLOSEST:
            kept.append(i)
    return np.array(kept if len(kept) > 1 else [0, len(line) - 1])


def tangents(points: Array) -> Array:
    """(N, 2) unit directions: along the chord between a point's neighbours."""
    chords = np.concatenate([points[1:2] - points[:1], points[2:] - points[:-2]])
    chords = np.concatenate([chords, points[-1:] - points[-2:-1]])
    steps = np.diff(points, axis=0)[np.minimum(np.arange(len(points)), len(points) - 2)]
    # A line that turns back on itself has no chord: there its next step gives the direction.
    chords = np.where(np.linalg.norm(chords, axis=1, keepdims=True) < _CLOSEST, steps, chords)
    return chords / np.maximum(np.linalg.norm(chords, axis=1, keepdims=True), 1e-12)


def piece(start: Array, end: Array, first: Array, last: Array) -> tuple[Array, float]:
    """A cubic's coefficients a..d of u and v, (2, 4), in the axes of its start; and its length."""
    turn = np.array([[first[0], first[1]], [-first[1], first[0]]])
    chord, out = turn @ (end - start), turn @ last
    size = float(np.linalg.norm(chord))
    t0, t1 = np.array([size, 0.0]), out * size
    cubic = np.stack([np.zeros(2), t0, 3 * chord - 2 * t0 - t1, t0 + t1 - 2 * chord], axis=1)
    p = (_NODES + 1) / 2
    speed = cubic[:, 1:] @ np.stack([np.ones_like(p), 2 * p, 3 * p**2])
    return cubic, float(np.linalg.norm(speed, axis=0) @ _WEIGHTS / 2)


def linear(s: Array, values: Array, start: str = "s") -> list[dict[str, float]]:
    """Rows a + b ds that go through the values at s; all but the last point begin one."""
    slopes = np.diff(values) / np.maximum(np.diff(s), 1e-12)
    return [
        {start: float(at), "a": float(a), "b": float(b), "c": 0.0, "d": 0.0}
        for at, a, b in zip(s[:-1], values[:-1], slopes, strict=True)
    ]


def widths(lane: Lane, line: Array, tangents: Array) -> Array:
    """(N, 2) metres from the centreline to the left and right boundary, at right angles."""
    left = np.stack([-tangents[:, 1], tangents[:, 0]], axis=1)
    sides = ((lane.left_boundary, left), (lane.right_boundary, -left))
    return np.stack([_to(b[:, :2], line[:, :2], way) for b, way in sides], axis=1)


def _to(boundary: Array, points: Array, ways: Array) -> Array:
    """(N,) distances from points along directions to a polyline; to its nearest point if beside."""
    a, step = boundary[:-1], np.diff(boundary, axis=0)
    gap = a[None] - points[:, None]
    cross = ways[:, None, 0] * step[None, :, 1] - ways[:, None, 1] * step[None, :, 0]
    with np.errstate(divide="ignore", invalid="ignore"):
        along = (gap[..., 0] * step[:, 1] - gap[..., 1] * step[:, 0]) / cross
        share = (gap[..., 0] * ways[:, None, 1] - gap[..., 1] * ways[:, None, 0]) / cross
    hit = np.where((share >= 0) & (share <= 1) & (along >= 0), along, np.inf).min(axis=1)
    length = np.maximum((step**2).sum(axis=1), 1e-12)
    foot = np.clip(-(gap * step).sum(axis=2) / length, 0, 1)
    nearest = np.linalg.norm(gap + foot[..., None] * step, axis=2).min(axis=1)
    return np.where(np.isfinite(hit) & (hit < 2 * nearest + _CLOSEST), hit, nearest)
