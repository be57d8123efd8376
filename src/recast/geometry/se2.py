"""Planar geometry: poses (x, y, heading) in metres and radians, and polylines with arc length.

Headings are counter-clockwise from x. A pose array (..., 3) is read as `target_from_source`: the
source frame's origin and heading seen in the target frame.
"""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property

import numpy as np
from numpy.typing import ArrayLike, NDArray

from recast.arrays import Array
from recast.geometry import se3


def wrap_angle(angle: ArrayLike) -> Array:
    """Angles (...) wrapped to [-pi, pi); those within stay as they are, to the last bit."""
    angle = np.asarray(angle, np.float64)
    inside = (angle >= -np.pi) & (angle < np.pi)
    if inside.all():
        return angle.copy()
    wrapped = (angle + np.pi) % (2 * np.pi) - np.pi
    wrapped = np.where(wrapped >= np.pi, -np.pi, wrapped)  # the remainder may round up to 2 pi
    return np.where(inside, angle, wrapped)


def compose(a_from_b: ArrayLike, b_from_c: ArrayLike) -> Array:
    """Poses (..., 3) of c in a; headings are wrapped."""
    a, b = np.asarray(a_from_b, np.float64), np.asarray(b_from_c, np.float64)
    cos, sin = np.cos(a[..., 2]), np.sin(a[..., 2])
    return np.stack(
        [
            a[..., 0] + cos * b[..., 0] - sin * b[..., 1],
            a[..., 1] + sin * b[..., 0] + cos * b[..., 1],
            wrap_angle(a[..., 2] + b[..., 2]),
        ],
        axis=-1,
    )


def inverse(a_from_b: ArrayLike) -> Array:
    """Poses (..., 3) of a in b."""
    a = np.asarray(a_from_b, np.float64)
    cos, sin = np.cos(a[..., 2]), np.sin(a[..., 2])
    return np.stack(
        [
            -cos * a[..., 0] - sin * a[..., 1],
            sin * a[..., 0] - cos * a[..., 1],
            wrap_angle(-a[..., 2]),
        ],
        axis=-1,
    )


def relative(reference: ArrayLike, poses: ArrayLike) -> Array:
    """Poses (..., 3) expressed in the frame of `reference` (..., 3)."""
    return compose(inverse(reference), poses)


def from_se3(matrix: ArrayLike) -> Array:
    """Planar poses (..., 3) of transforms (..., 4, 4): drops z, roll and pitch."""
    matrix = np.asarray(matrix, np.float64)
    return np.stack([matrix[..., 0, 3], matrix[..., 1, 3], se3.yaw(matrix)], axis=-1)


def to_se3(pose: ArrayLike, z: ArrayLike = 0.0) -> Array:
    """Transforms (..., 4, 4) of planar poses (..., 3) at height z (...) in metres."""
    pose = np.asarray(pose, np.float64)
    height = np.broadcast_to(np.asarray(z, np.float64), pose.shape[:-1])
    translation = np.stack([pose[..., 0], pose[..., 1], height], axis=-1)
    return se3.from_rotation_translation(se3.rotation_z(pose[..., 2]), translation)


REACH = 10.0
"""Metres along a chain within which a point is looked for near a known place: a car at 50 m/s
drives as far in a step of 0.2 s."""
_SAME = 0.5
"""Metres by which places of a chain that a vehicle passes twice are taken to be one."""
_AHEAD = 5
"""States over which the direction of the motion is taken."""
_ACROSS = 0.5
"""Cosine of the turn off a way below which somebody crosses it."""
_BLOCK = 1_000_000
"""Point-segment pairs projected at once: a LiDAR sweep on a long route would fill the memory."""


@dataclass(frozen=True)
class Polyline:
    """A directed chain of straight segments.

    Attributes:
        points: (N, 2) metres, N >= 2, no two neighbours equal.
    """

    points: Array

    def __post_init__(self) -> None:
        points = np.asarray(self.points, np.float64)
        if points.ndim != 2 or points.shape[1] != 2 or len(points) < 2:
            raise ValueError(f"Polyline.points: expected (N >= 2, 2), got {points.shape}")
        if not np.all(np.isfinite(points)):
            raise ValueError("Polyline.points: NaN or infinite")
        if np.any(np.linalg.norm(np.diff(points, axis=0), axis=1) == 0.0):
            raise ValueError("Polyline.points: two neighbours are equal")
        object.__setattr__(self, "points", points)

    @classmethod
    def from_points(cls, points: ArrayLike, min_step: float = 1e-6) -> Polyline:
        """Build from points (N, >=2) without those within `min_step` metres of the last kept.
        Raises ValueError: fewer than two distinct points remain."""
        xy = np.asarray(points, np.float64)[:, :2]
        kept = [0] if len(xy) else []
        for i in range(1, len(xy)):
            if np.hypot(*(xy[i] - xy[kept[-1]])) > min_step:
                kept.append(i)
        return cls(xy[kept])

    @cached_property
    def arc_lengths(self) -> Array:
        """Arc length (N,) at each vertex, from 0."""
        steps = np.linalg.norm(np.diff(self.points, axis=0), axis=1)
        return np.concatenate([[0.0], np.cumsum(steps)])

    @property
    def length(self) -> float:
        """Total length in metres."""
        return float(self.arc_lengths[-1])

    @cached_property
    def _directions(self) -> Array:
        steps = np.diff(self.points, axis=0)
        return steps / np.linalg.norm(steps, axis=1, keepdims=True)

    def _segment(self, s: Array) -> NDArray[np.intp]:
        index = np.searchsorted(self.arc_lengths, s, side="right") - 1
        return np.clip(index, 0, len(self.points) - 2)

    def position(self, s: ArrayLike) -> Array:
        """Points (..., 2) at arc lengths (...), continued straight beyond both ends.

        The caller decides whether to go there: see `length`.
        """
        s = np.asarray(s, np.float64)
        index = self._segment(s)
        along = s - self.arc_lengths[index]
        return self.points[index] + along[..., None] * self._directions[index]

    def heading(self, s: ArrayLike) -> Array:
        """Tangent heading (...) in radians at arc lengths (...)."""
        direction = self._directions[self._segment(np.asarray(s, np.float64))]
        return np.arctan2(direction[..., 1], direction[..., 0])

    def to_cartesian(self, s: ArrayLike, lateral: ArrayLike) -> Array:
        """Points (..., 2) of Frenet coordinates: s along, lateral to the left, metres."""
        heading = self.heading(s)
        normal = np.stack([-np.sin(heading), np.cos(heading)], axis=-1)
        return self.position(s) + np.asarray(lateral, np.float64)[..., None] * normal

    def to_frenet(
        self, points: ArrayLike, near: ArrayLike | None = None, reach: float = REACH
    ) -> tuple[Array, Array]:
        """Frenet coordinates of points (..., 2): the nearest point of the chain.

        Before the start and past the end, that is the end point.

        Args:
            near: arc lengths (...) about which the nearest point is looked for, within `reach`
                metres: a chain may come back over itself. None for all of the chain.

        Returns:
            s (...), within [0, length], and the signed distance (...), positive to the left.
        """
        query = np.asarray(points, np.float64)
        flat = query.reshape(-1, 2)
        s, lateral = np.empty(len(flat)), np.empty(len(flat))
        around = None if near is None else np.broadcast_to(near, query.shape[:-1]).reshape(-1)
        block = max(1, _BLOCK // len(self.points))
        for start in range(0, len(flat), block):
            rows = slice(start, start + block)
            known = None if around is None else around[rows]
            s[rows], lateral[rows] = self._nearest(flat[rows], known, reach)
        return s.reshape(query.shape[:-1]), lateral.reshape(query.shape[:-1])

    def gone(self, pose: ArrayLike) -> float:
        """Metres that a walker whose way this is has gone when it is at a planar pose (3,).

        Those to the nearest place of the way, which goes straight on beyond its ends; who looks
        back along it goes back. Who looks across (by 60 degrees and more), as on a scenario's way,
        has gone those beside it. So who turns on the spot moves no leg but where these change over.
        """
        pose = np.asarray(pose, np.float64)
        place, heading = pose[:2], pose[2]
        along = self.to_frenet(place)[0]
        tangent = self.heading(along)
        ahead = np.array([np.cos(tangent), np.sin(tangent)])
        offset = place - self.position(along)
        turned = float(heading - tangent)
        if abs(np.cos(turned)) < _ACROSS:
            beside = ahead[0] * offset[1] - ahead[1] * offset[0]
            return float(np.sign(np.sin(turned)) * beside)
        return float(np.sign(np.cos(turned)) * (along + offset @ ahead))

    def _nearest(self, flat: Array, near: Array | None, reach: float) -> tuple[Array, Array]:
        starts, directions = self.points[:-1], self._directions
        lengths = np.diff(self.arc_lengths)
        offset = flat[:, None, :] - starts  # (Q, N-1, 2)
        along = np.clip(np.einsum("qnd,nd->qn", offset, directions), 0.0, lengths)
        gap = offset - along[..., None] * directions
        distance2 = np.einsum("qnd,qnd->qn", gap, gap)
        if near is not None:
            # Of segments, whole ones: the one at `near` is always among them.
            begin = self.arc_lengths[:-1] > near[:, None] + reach
            end = self.arc_lengths[1:] < near[:, None] - reach
            away = begin | end
            away[:, [0, -1]] &= ~away.all(axis=1, keepdims=True)
            distance2 = np.where(away, np.inf, distance2)
        best = np.argmin(distance2, axis=1)
        rows = np.arange(len(flat))
        # At a vertex, the mean direction tells the side: in a sharp bend each segment alone errs.
        tangent = directions[best]
        before = (along[rows, best] <= 0.0) & (best > 0)
        after = (along[rows, best] >= lengths[best]) & (best < len(lengths) - 1)
        tangent = tangent + np.where(before[:, None], directions[best - 1], 0.0)
        tangent += np.where(after[:, None], directions[np.minimum(best + 1, len(lengths) - 1)], 0.0)
        side_vector = gap[rows, best]
        cross = tangent[:, 0] * side_vector[:, 1] - tangent[:, 1] * side_vector[:, 0]
        side = np.where(cross >= 0, 1.0, -1.0)
        return self.arc_lengths[best] + along[rows, best], side * np.sqrt(distance2[rows, best])

    def follow(self, points: ArrayLike) -> Array:
        """Arc lengths (T,) of points (T, 2) in the order of time: each near the one before.

        Of several places of the chain that are as near to the first point, to half a metre, as the
        nearest one, the first that the chain comes to in the direction of the motion counts.
        """
        query = np.asarray(points, np.float64)
        s = np.empty(len(query))
        s[0] = self._first(query)
        for k in range(1, len(query)):
            moved = float(np.linalg.norm(query[k] - query[k - 1]))
            s[k] = self.to_frenet(query[k], s[k - 1], REACH + moved)[0]
        return s

    def _first(self, points: Array) -> float:
        grid = np.linspace(0.0, self.length, int(self.length / REACH) + 2)
        s, lateral = self.to_frenet(np.broadcast_to(points[0], (len(grid), 2)), grid)
        near = s[np.abs(lateral) <= np.abs(lateral).min() + _SAME]
        moved = points[min(_AHEAD, len(points) - 1)] - points[0]
        heading = self.heading(near)
        agrees = np.cos(heading) * moved[0] + np.sin(heading) * moved[1] >= 0.0
        return float(near[agrees].min() if agrees.any() else near.min())
