"""Shapes in the plane: smooth directed curves that roads follow, and outlines as triangles."""

from __future__ import annotations

import itertools
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from typing import NamedTuple

import numpy as np
import shapely
from numpy.random import Generator
from numpy.typing import ArrayLike, NDArray

from recast.arrays import Array
from recast.geometry import se2
from recast.logs import GroundHeight
from recast.synthetic.surface import MATERIAL_INDEX, Surface, quads

_STEP = 0.25
"""Metres between samples: in a bend of 8 m radius, a chord is then 1 mm off the curve."""


class Pose(NamedTuple):
    """A place and direction: x, y metres, heading radians."""

    x: float
    y: float
    heading: float


@dataclass(frozen=True)
class ReferenceLine:
    """A densely sampled curve with exact headings, so that offset curves meet without gaps."""

    arc_lengths: Array  # (N,) metres from 0
    points: Array  # (N, 2) metres
    headings: Array  # (N,) radians, continuous

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


Colour = tuple[float, float, float]
Cover = tuple[Colour, str]
"""Colour and material of a piece of ground."""

KERB_HEIGHT = 0.12
_KERB_WIDTH = 0.16
_STONE = 1.5
"""Metres that a kerb stone is long."""
_HORIZON = 1800.0
_CELL = 1.0

PAVING: Cover = ((0.30, 0.29, 0.27), "concrete")
GRASS: Cover = ((0.085, 0.135, 0.035), "grass")
SOIL: Cover = ((0.20, 0.15, 0.10), "soil")
GRAVEL: Cover = ((0.26, 0.24, 0.21), "soil")


@dataclass(frozen=True)
class Band:
    """A strip along the asphalt's edge."""

    width: float  # metres
    cover: Cover  # cover of the strip
    height: float = KERB_HEIGHT  # z at its outer edge, metres


@dataclass(frozen=True)
class Edge:
    """What lies beside the asphalt."""

    kerb: bool  # whether a kerb stone comes first
    bands: tuple[Band, ...]  # strips from the asphalt outwards
    land: Cover  # cover from there to the horizon
    hills: float = 12.0  # height of the hills far off, metres

    @property
    def width(self) -> float:
        """Metres of all bands."""
        return sum(band.width for band in self.bands)

    def profile(self) -> tuple[Array, Array]:
        """Distances from the asphalt, and z there."""
        distance = np.cumsum([0.0, *(band.width for band in self.bands)])
        start = KERB_HEIGHT if self.kerb else 0.0
        return distance, np.array([start, *(band.height for band in self.bands)])


@dataclass(frozen=True)
class Island:
    """A raised area within the asphalt."""

    outline: shapely.Polygon  # its kerb's face
    cover: Cover = PAVING  # cover of its top


@dataclass(frozen=True)
class Ground:
    """The shape of the ground."""

    asphalt: shapely.Geometry  # area from kerb to kerb, without islands
    filled: shapely.Geometry  # the asphalt with its islands
    islands: tuple[Island, ...]  # raised areas
    edge: Edge  # what lies beside
    colour: Colour  # colour of the asphalt

    @classmethod
    def make(
        cls,
        paved: Sequence[shapely.Geometry],
        islands: Sequence[Island],
        edge: Edge,
        colour: Colour,
        fillet: float,
    ) -> Ground:
        """Join pieces of asphalt; inner corners are rounded with radius `fillet`."""
        union = shapely.union_all(paved, grid_size=1e-4)
        holes = [
            shapely.Polygon(ring) for part in shapely.get_parts(union) for ring in part.interiors
        ]
        closed = union.buffer(fillet, quad_segs=10).buffer(-fillet, quad_segs=10)
        filled = shapely.union_all([closed, union, *(h for h in holes if h.area < 2.0)])
        filled = shapely.simplify(filled, 0.004)
        raised = shapely.union_all([island.outline for island in islands])
        return cls(filled.difference(raised), filled, tuple(islands), edge, colour)

    def height(self, points: Array) -> Array:
        """z (N,) of the ground at points (N, 2) near the road."""
        place = shapely.points(points)
        away = shapely.distance(self.filled, place)
        z = np.where(away > 0, np.interp(away, *self.edge.profile()), 0.0)
        for island in self.islands:
            z[shapely.covers(island.outline, place)] = KERB_HEIGHT
        return z

    def grid(self) -> GroundHeight:
        """Heights on a grid; a whole cell around the asphalt counts as road."""
        low_x, low_y, high_x, high_y = self.filled.bounds
        margin = 12.0
        origin = np.floor([low_x - margin, low_y - margin])
        columns, rows = np.ceil((np.array([high_x, high_y]) + margin - origin) / _CELL).astype(int)
        x, y = np.meshgrid(np.arange(columns), np.arange(rows))
        points = origin + _CELL * np.stack([x, y], axis=-1).reshape(-1, 2)
        z = np.full(len(points), self.edge.profile()[1][-1])
        near = self.filled.buffer(self.edge.width)
        shapely.prepare(near)
        beside = shapely.contains_xy(near, points)
        z[beside] = self.height(points[beside])
        road = self.asphalt.buffer(_CELL)
        shapely.prepare(road)
        z[shapely.contains_xy(road, points)] = 0.0
        return GroundHeight(origin, _CELL, z.reshape(rows, columns))

    def surfaces(self, rng: Generator) -> list[Surface]:
        """All triangles, of the asphalt and to the horizon."""
        parts = [flat(self.asphalt, 0.0, self.colour, "asphalt")]
        if self.edge.kerb or self.islands:
            raised = shapely.union_all([island.outline for island in self.islands])
            lines = self.asphalt if self.edge.kerb else raised
            parts += _kerbs(lines, not self.edge.kerb, rng)
        for island in self.islands:
            top = island.outline.buffer(-0.02)
            parts.append(flat(top, KERB_HEIGHT - 0.002, *island.cover))
        inside = self.filled
        for band, distance in zip(self.edge.bands, self.edge.profile()[0][1:], strict=True):
            outside = self.filled.buffer(distance, quad_segs=6)
            ring = outside.difference(inside)
            parts.append(flat(ring, self._band_height, *band.cover))
            inside = outside
        return parts + self._land(inside, rng)

    def _band_height(self, points: Array) -> Array:
        away = shapely.distance(self.filled, shapely.points(points))
        lowered = 0.002 if self.edge.kerb else 0.0  # below the tops of the kerb stones
        return np.interp(away, *self.edge.profile()) - lowered

    def _land(self, inside: shapely.Geometry, rng: Generator) -> list[Surface]:
        colour, material = self.edge.land
        level = float(self.edge.profile()[1][-1]) - (0.002 if self.edge.kerb else 0.0)
        low_x, low_y, high_x, high_y = inside.bounds
        centre = np.array([(low_x + high_x) / 2, (low_y + high_y) / 2])
        near = float(np.hypot(high_x - low_x, high_y - low_y)) / 2 + 90.0
        turn = np.linspace(0.0, 2 * np.pi, 97)
        rim = np.stack([np.cos(turn), np.sin(turn)], axis=1)
        disc = shapely.Polygon(centre + near * rim[:-1])
        radii = np.geomspace(near, _HORIZON, 9)
        bumps = np.zeros((len(radii), len(turn)))
        for k in range(1, 7):
            phase = rng.uniform(0, 2 * np.pi, len(radii))
            bumps += np.cos(k * turn[None] + phase[:, None]) / k**0.7
        rise = np.linspace(0.0, 1.0, len(radii))[:, None] ** 1.3
        bumps = self.edge.hills * rise * (1.0 + bumps)
        bumps[:, -1] = bumps[:, 0]
        rings = centre + radii[:, None, None] * rim
        points = np.concatenate([rings, (level + np.maximum(bumps, 0))[..., None]], axis=-1)
        corners = np.stack([points[:-1, :-1], points[1:, :-1], points[1:, 1:], points[:-1, 1:]], 2)
        shade = rng.uniform(0.85, 1.15, (corners.shape[0] * corners.shape[1], 1))
        far = np.array(colour if material in ("grass", "soil") else GRASS[0])
        return [
            flat(disc.difference(inside), level, colour, material),
            quads(corners.reshape(-1, 4, 3), far * shade, "grass"),
        ]


def _kerbs(region: shapely.Geometry, outwards: bool, rng: Generator) -> list[Surface]:
    """Kerb stones along the boundary of a region.

    Args:
        region: asphalt, or with `outwards` raised islands, of which the inside is high.
        outwards: the stones' faces look out of the region.
        rng: random generator of the stones' colours.
    """
    parts: list[Surface] = []
    for polygon in shapely.get_parts(region):
        if polygon.geom_type != "Polygon":
            continue
        turned = shapely.orient_polygons(polygon, exterior_cw=outwards)
        for ring in (turned.exterior, *turned.interiors):
            parts += _kerb_ring(shapely.get_coordinates(shapely.segmentize(ring, _STONE)), rng)
    return parts


def _kerb_ring(points: Array, rng: Generator) -> list[Surface]:
    """Stones along a closed line (N, 2), first point repeated, with the low side on its left."""
    along = np.diff(points, axis=0)
    keep = np.linalg.norm(along, axis=1) > 1e-4
    points = np.concatenate([points[:-1][keep], points[:1]])
    along = np.diff(points, axis=0)
    along /= np.linalg.norm(along, axis=1, keepdims=True)
    right = np.stack([along[:, 1], -along[:, 0]], axis=1)
    mitre = right + np.roll(right, 1, axis=0)
    length2 = np.einsum("ij,ij->i", mitre, mitre)
    mitre *= (2 / np.maximum(length2, 0.6))[:, None]
    mitre = np.concatenate([mitre, mitre[:1]])
    back = points + _KERB_WIDTH * mitre
    foot, top, rear = (
        np.insert(place, 2, z, axis=1)
        for place, z in ((points, -0.02), (points, KERB_HEIGHT), (back, KERB_HEIGHT))
    )
    colour = np.array([0.34, 0.335, 0.32]) * rng.uniform(0.82, 1.12, (len(along), 1))
    return [ribbon(top, rear, colour, "concrete"), ribbon(foot, top, colour * 0.92, "concrete")]


def forest_belt(
    centre: Array, radius: float, start: float, turn: float, height: float, rng: Generator
) -> Surface:
    """Woods far off: a jagged wall of foliage on an arc around `centre`, seen from within."""
    count = max(int(abs(turn) * radius / 1.8), 3)
    angle = np.linspace(start, start + turn, count + 1)
    rows = []
    for lift, back in ((0.0, 0.0), (0.55, -1.5), (1.0, 3.0), (0.6, 9.0)):
        crowns = np.convolve(rng.normal(size=count + 5), np.full(5, 0.07), mode="valid")
        wave = 1.0 + (crowns + rng.uniform(-0.05, 0.05, count + 1)) * (lift > 0)
        reach = radius + back + rng.uniform(-1.0, 1.0, count + 1)
        xy = centre + reach[:, None] * np.stack([np.cos(angle), np.sin(angle)], axis=1)
        rows.append(np.concatenate([xy, (height * lift * wave)[:, None]], axis=1))
    corners = []
    for low, high in itertools.pairwise(rows):
        corners.append(np.stack([low[1:], low[:-1], high[:-1]], axis=1))
        corners.append(np.stack([low[1:], high[:-1], high[1:]], axis=1))
    triangles = np.concatenate(corners)
    tone = rng.uniform(0.7, 1.2, (len(triangles), 1)) * np.array([0.045, 0.08, 0.025])
    return soup(triangles, tone, "foliage")
