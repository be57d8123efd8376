"""Smooth directed curves that roads follow."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import NamedTuple

import numpy as np
from numpy.typing import ArrayLike, NDArray

from recast.geometry import se2

Array = NDArray[np.float64]

_STEP = 0.25
"""Metres between samples: in a bend of 8 m radius, a chord is then 1 mm off the curve."""


class Pose(NamedTuple):
    """A place and direction: x, y metres, heading radians."""

    x: float
    y: float
    heading: float


@dataclass(frozen=True)
class ReferenceLine:
    """A densely sampled curve with exact headings, so that offset curves meet without gaps.

    Attributes:
        arc_lengths: (N,) metres from 0.
        points: (N, 2) metres.
        headings: (N,) radians, continuous.
    """

    arc_lengths: Array
    points: Array
    headings: Array

    @classmethod
    def from_bends(
        cls, start: Pose, bends: Sequence[tuple[float, float]], transition: float = 24.0
    ) -> ReferenceLine:
        """A chain of (length in metres, curvature in 1/m, left positive).

        The curvature changes linearly over about `transition` metres around each joint, as on real
        roads (clothoids).
        """
        total = sum(length for length, _ in bends)
        s = np.linspace(0.0, total, max(int(np.ceil(total / _STEP)), 2) + 1)
        ends = np.cumsum([length for length, _ in bends])
        piece = np.minimum(np.searchsorted(ends, s, side="right"), len(bends) - 1)
        curvature = np.array([value for _, value in bends])[piece]
        step = s[1]
        half = int(transition / step / 2)
        if half > 0:
            window = np.ones(2 * half + 1) / (2 * half + 1)
            curvature = np.convolve(np.pad(curvature, half, mode="edge"), window, mode="valid")
        heading = start.heading + _accumulate((curvature[1:] + curvature[:-1]) / 2 * step)
        middle = (heading[1:] + heading[:-1]) / 2
        x = start.x + _accumulate(np.cos(middle) * step)
        y = start.y + _accumulate(np.sin(middle) * step)
        return cls(s, np.stack([x, y], axis=1), heading)

    @classmethod
    def straight(cls, start: Pose, length: float) -> ReferenceLine:
        """A straight line."""
        return cls.from_bends(start, [(length, 0.0)], transition=0.0)

    @classmethod
    def between(cls, start: Pose, end: Pose, reach: float = np.inf) -> ReferenceLine:
        """A curve that leaves `start` and arrives at `end` in their directions.

        Where the two directions cross ahead, it runs straight until `reach` metres before the
        crossing and rounds the corner; else it is one cubic curve.
        """
        a, b = np.array(start[:2]), np.array(end[:2])
        along_a, along_b = _direction(start.heading), _direction(end.heading)
        turn = abs(float(se2.wrap_angle(end.heading - start.heading)))
        if turn > np.deg2rad(20):
            ahead, behind = np.linalg.solve(np.stack([along_a, along_b], axis=1), b - a)
            if ahead > 0.5 and behind > 0.5:
                near = min(ahead, behind, reach)
                corner = a + ahead * along_a
                first, last = corner - near * along_a, corner + near * along_b
                curve = _cubic(first, last, along_a, along_b, 0.6 * near)
                return cls._through([a], curve, [b])
        handle = float(np.linalg.norm(b - a)) * (0.36 + 0.04 * turn)
        return cls._through([], _cubic(a, b, along_a, along_b, handle), [])

    @classmethod
    def _through(cls, before: list[Array], curve: Array, after: list[Array]) -> ReferenceLine:
        rough = np.concatenate([np.reshape(before, (-1, 2)), curve, np.reshape(after, (-1, 2))])
        keep = np.concatenate([[True], np.linalg.norm(np.diff(rough, axis=0), axis=1) > 1e-6])
        rough = rough[keep]
        s = _accumulate(np.linalg.norm(np.diff(rough, axis=0), axis=1))
        even = np.linspace(0.0, s[-1], max(int(np.ceil(s[-1] / _STEP)), 2) + 1)
        points = np.stack([np.interp(even, s, rough[:, 0]), np.interp(even, s, rough[:, 1])], 1)
        tangent = np.gradient(points, even, axis=0, edge_order=2)
        return cls(even, points, np.unwrap(np.arctan2(tangent[:, 1], tangent[:, 0])))

    @classmethod
    def circle(cls, centre: ArrayLike, radius: float, start: float, turn: float) -> ReferenceLine:
        """An arc around `centre`, from angle `start` by `turn` radians (positive: to the left)."""
        angle = np.linspace(start, start + turn, int(np.ceil(abs(turn) * radius / _STEP)) + 2)
        points = np.asarray(centre) + radius * np.stack([np.cos(angle), np.sin(angle)], axis=1)
        heading = angle + np.copysign(np.pi / 2, turn)
        return cls(radius * np.abs(angle - start), points, heading)

    def part(self, start: float, end: float) -> ReferenceLine:
        """The curve between two arc lengths, which count from 0 again."""
        count = max(int(np.ceil((end - start) / _STEP)), 2) + 1
        s = np.linspace(start, end, count)
        return ReferenceLine(s - start, self.offset(s, 0.0), self.heading(s))

    @property
    def length(self) -> float:
        """Metres from end to end."""
        return float(self.arc_lengths[-1])

    def heading(self, s: ArrayLike) -> Array:
        """Tangent heading (...) at arc lengths (...)."""
        angle: Array = np.interp(np.asarray(s, np.float64), self.arc_lengths, self.headings)
        return angle

    def offset(self, s: ArrayLike, lateral: ArrayLike) -> Array:
        """Points (..., 2), `lateral` metres to the left of the curve at arc lengths s (...).

        Continued straight beyond both ends.
        """
        s, lateral = np.broadcast_arrays(np.asarray(s, np.float64), lateral)
        inside = np.clip(s, 0.0, self.length)
        heading = self.heading(inside)
        forward = np.stack([np.cos(heading), np.sin(heading)], axis=-1)
        left = np.stack([-forward[..., 1], forward[..., 0]], axis=-1)
        on = np.stack(
            [np.interp(inside, self.arc_lengths, self.points[:, k]) for k in range(2)], axis=-1
        )
        moved: Array = on + (s - inside)[..., None] * forward
        return moved + lateral[..., None] * left

    def pose(self, s: float, lateral: float = 0.0) -> Pose:
        """The pose at arc length s, `lateral` metres to the left."""
        x, y = self.offset(s, lateral)
        return Pose(float(x), float(y), float(self.heading(s)))


def _direction(heading: float) -> Array:
    return np.array([np.cos(heading), np.sin(heading)])


def _accumulate(steps: Array) -> Array:
    return np.concatenate([[0.0], np.cumsum(steps)])


def _cubic(a: Array, b: Array, along_a: Array, along_b: Array, handle: float) -> Array:
    """Bezier curve (200, 2) with both inner points `handle` metres from the ends."""
    t = np.linspace(0.0, 1.0, 200)[:, None]
    inner_a, inner_b = a + handle * along_a, b - handle * along_b
    curve: Array = (
        (1 - t) ** 3 * a + 3 * (1 - t) ** 2 * t * inner_a + 3 * (1 - t) * t**2 * inner_b + t**3 * b
    )
    return curve
