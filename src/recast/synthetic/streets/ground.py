"""Everything one can stand on: asphalt, kerbs, pavements, verges, land to the horizon."""

from __future__ import annotations

import itertools
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
import shapely
from numpy.random import Generator

from recast.arrays import Array
from recast.logs import GroundHeight
from recast.synthetic.scenery.primitives import quads
from recast.synthetic.streets.shapes import flat, ribbon, soup
from recast.synthetic.surface import Surface

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
    """A strip along the asphalt's edge.

    Attributes:
        width: metres.
        cover: cover of the strip.
        height: z at its outer edge, metres.
    """

    width: float
    cover: Cover
    height: float = KERB_HEIGHT


@dataclass(frozen=True)
class Edge:
    """What lies beside the asphalt.

    Attributes:
        kerb: whether a kerb stone comes first.
        bands: strips from the asphalt outwards.
        land: cover from there to the horizon.
        hills: height of the hills far off, metres.
    """

    kerb: bool
    bands: tuple[Band, ...]
    land: Cover
    hills: float = 12.0

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
    """A raised area within the asphalt.

    Attributes:
        outline: its kerb's face.
        cover: cover of its top.
    """

    outline: shapely.Polygon
    cover: Cover = PAVING


@dataclass(frozen=True)
class Ground:
    """The shape of the ground.

    Attributes:
        asphalt: area from kerb to kerb, without islands.
        filled: the asphalt with its islands.
        islands: raised areas.
        edge: what lies beside.
        colour: colour of the asphalt.
    """

    asphalt: shapely.Geometry
    filled: shapely.Geometry
    islands: tuple[Island, ...]
    edge: Edge
    colour: Colour

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
