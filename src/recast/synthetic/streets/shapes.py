"""Shapes in the plane: smooth directed curves that roads follow, and outlines as triangles."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from typing import NamedTuple

import numpy as np
import shapely
from numpy.typing import ArrayLike, NDArray

from recast.arrays import Array
from recast.geometry import se2
from recast.synthetic.scenery.primitives import quads
from recast.synthetic.surface import MATERIAL_INDEX, Surface

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
        return np.interp(np.asarray(s, np.float64), self.arc_lengths, self.headings)

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


def triangulate(region: shapely.Geometry) -> Array:
    """Triangles (T, 3, 2), counter-clockwise, that fill polygons with holes."""
    parts = [part for part in shapely.get_parts(region) if part.geom_type == "Polygon"]
    triangles = [
        shapely.get_coordinates(shapely.constrained_delaunay_triangles(part)).reshape(-1, 4, 2)
        for part in parts
        if part.area > 1e-6
    ]
    if not triangles:
        return np.zeros((0, 3, 2))
    return _upwards(np.concatenate(triangles)[:, :3])


def _upwards(triangles: Array) -> Array:
    """Triangles (T, 3, 2), all counter-clockwise."""
    a, b = triangles[:, 1] - triangles[:, 0], triangles[:, 2] - triangles[:, 0]
    clockwise = a[:, 0] * b[:, 1] - a[:, 1] * b[:, 0] < 0
    return np.where(clockwise[:, None, None], triangles[:, ::-1], triangles)


def placed(outline: shapely.Geometry, pose: Pose) -> shapely.Geometry:
    """An outline in its own frame, moved to a pose."""
    c, s = np.cos(pose.heading), np.sin(pose.heading)
    turn = np.array([[c, -s], [s, c]])
    return shapely.transform(outline, lambda xy: xy @ turn.T + np.array([pose.x, pose.y]))


def without_holes(region: shapely.Geometry) -> list[shapely.Polygon]:
    """Polygons without holes that together cover a region: cut through the middle of each hole."""
    done, left = [], [part for part in shapely.get_parts(region) if part.geom_type == "Polygon"]
    while left:
        part = left.pop()
        if len(part.interiors) == 0:
            done.append(part)
            continue
        low_x, low_y, high_x, high_y = part.bounds
        middle = shapely.Polygon(part.interiors[0]).centroid.x
        for box in (
            shapely.box(low_x - 1, low_y - 1, middle, high_y + 1),
            shapely.box(middle, low_y - 1, high_x + 1, high_y + 1),
        ):
            cut = shapely.get_parts(part.intersection(box))
            left += [piece for piece in cut if piece.geom_type == "Polygon" and piece.area > 1e-6]
    return done


def soup(corners: ArrayLike, colour: ArrayLike, material: str) -> Surface:
    """Separate flat triangles (T, 3, 3), with colour (3,) or (T, 3)."""
    corners = np.asarray(corners, np.float64).reshape(-1, 3, 3)
    faces = np.arange(3 * len(corners)).reshape(-1, 3)
    return Surface.make(corners.reshape(-1, 3), faces, colour, material, crease=0.0)


def flat(
    region: shapely.Geometry,
    height: float | Callable[[Array], Array],
    colour: ArrayLike,
    material: str,
) -> Surface:
    """A region seen from above, at a height or at heights given by place (N, 2) -> (N,)."""
    corners = triangulate(region)
    xy = corners.reshape(-1, 2)
    z = height(xy) if callable(height) else np.full(len(xy), height)
    return soup(np.concatenate([xy, z[:, None]], axis=1), colour, material)


def ribbon(left: Array, right: Array, colour: ArrayLike, material: str) -> Surface:
    """A strip between two lines (N, 3); seen from above when left is to the left."""
    return quads(np.stack([right[:-1], right[1:], left[1:], left[:-1]], axis=1), colour, material)


class Decals:
    """Collects thin flat shapes that lie on the ground."""

    def __init__(self) -> None:
        self._triangles: list[Array] = []
        self._colours: list[Array] = []
        self._materials: list[NDArray[np.uint8]] = []

    def add(self, triangles: ArrayLike, height: float, colour: ArrayLike, material: str) -> None:
        """Add triangles (T, 3, 2), turned to be seen from above, with colour (3,) or (T, 3)."""
        xy = _upwards(np.asarray(triangles, np.float64).reshape(-1, 3, 2))
        self._triangles.append(np.concatenate([xy, np.full((len(xy), 3, 1), height)], axis=2))
        self._colours.append(np.broadcast_to(np.asarray(colour, np.float64), (len(xy), 3)))
        self._materials.append(np.full(len(xy), MATERIAL_INDEX[material], np.uint8))

    def strip(
        self, left: Array, right: Array, height: float, colour: ArrayLike, material: str
    ) -> None:
        """Add a strip between two lines (N, 2) that run along each other."""
        corners = np.stack([right[:-1], right[1:], left[1:], left[:-1]], axis=1)
        colour = np.asarray(colour, np.float64)
        if colour.ndim == 2:
            colour = np.repeat(colour, 2, axis=0)
        self.add(corners[:, [0, 1, 2, 0, 2, 3]].reshape(-1, 3, 2), height, colour, material)

    def polygon(
        self, region: shapely.Geometry, height: float, colour: ArrayLike, material: str
    ) -> None:
        """Add the inside of a polygon."""
        self.add(triangulate(region), height, colour, material)

    def surface(self) -> Surface:
        """All shapes."""
        corners = np.concatenate([np.zeros((0, 3, 3)), *self._triangles])
        made = soup(corners, np.concatenate([np.zeros((0, 3)), *self._colours]), "asphalt")
        materials = np.concatenate([np.zeros(0, np.uint8), *self._materials])
        return Surface(made.vertices, made.faces, made.normals, made.colours, materials)
