"""Roads: a cross-section swept along a reference line, and what years do to its asphalt."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass

import numpy as np
import shapely
from numpy.random import Generator
from numpy.typing import ArrayLike

from recast.arrays import Array
from recast.logs import Lane
from recast.synthetic.streets.shapes import Decals, Pose, ReferenceLine

_STEP = 2.0
"""Metres between points of lanes."""
_TRACKS, _PATCHES, _SEALS, _COVERS = 0.001, 0.0018, 0.0026, 0.0034
_SOFT = ((0.48, 0.93), (0.34, 0.87), (0.18, 0.83))
"""Half-widths of a wheel track in metres, and its brightness inside each."""


@dataclass(frozen=True)
class Section:
    """What lies across a road, from the reference line outwards; traffic keeps right."""

    # forward, backward: lanes along and against the line (right and left of it).
    forward: int
    backward: int
    lane_width: float = 3.4  # metres
    median: float = 0.0  # metres between the two directions
    # parking_right, parking_left: metres of the parking lane, 0 for none.
    parking_right: float = 0.0
    parking_left: float = 0.0
    edge: float = 0.3  # metres between the outermost lane (or parking) and the kerb

    def lane(self, index: int) -> tuple[float, float]:
        """Lateral of the edges of a lane: inner, outer.

        Args:
            index: 1, 2, ... from the middle outwards for forward lanes, -1, -2, ... for backward.
        """
        inner = self.median / 2 + (abs(index) - 1) * self.lane_width
        side = -np.sign(index)
        return float(side * inner), float(side * (inner + self.lane_width))

    def lanes_edge(self, side: int) -> float:
        """Lateral of the outer edge of the lanes; side +1 left, -1 right."""
        count = self.backward if side > 0 else self.forward
        return side * (self.median / 2 + count * self.lane_width)

    def kerb(self, side: int) -> float:
        """Lateral of the kerb; side +1 left, -1 right."""
        parking = self.parking_left if side > 0 else self.parking_right
        return self.lanes_edge(side) + side * (parking + self.edge)


@dataclass(frozen=True)
class Road:
    """A section along a part of a reference line."""

    name: str  # first part of its lane ids
    line: ReferenceLine  # reference line, in the direction of the forward lanes
    section: Section  # what lies across
    # start, end: arc lengths between which there are lanes.
    start: float
    end: float
    speed_limit: float  # m/s
    paved: tuple[float, float]  # arc lengths between which there is asphalt, (start, end) or beyond
    # (arc length, metres) knots; both directions move apart by that much to each side.
    spread: tuple[tuple[float, float], ...] = ()
    block: float = 45.0  # metres that a lane segment is long, about

    def point(self, s: ArrayLike, lateral: ArrayLike, side: int | None = None) -> Array:
        """World points (..., 2) at road coordinates (...), `lateral` to the left.

        `side` (+1 left, -1 right) says which direction's half moves with `spread`; by default the
        half in which the point lies, and the middle stays.
        """
        s, lateral = np.broadcast_arrays(np.asarray(s, np.float64), np.asarray(lateral, np.float64))
        way = np.sign(lateral) if side is None else side
        return self.line.offset(s, lateral + way * self.apart(s))

    def apart(self, s: ArrayLike) -> Array:
        """Metres (...) that each direction is moved outwards, smooth between the knots."""
        s = np.asarray(s, np.float64)
        if not self.spread:
            return np.zeros_like(s)
        at, metres = np.array(self.spread).T
        k = np.clip(np.searchsorted(at, s, side="right") - 1, 0, len(at) - 2)
        u = np.clip((s - at[k]) / (at[k + 1] - at[k]), 0.0, 1.0)
        return metres[k] + (metres[k + 1] - metres[k]) * u * u * (3 - 2 * u)

    def pose(self, s: float, lateral: float, reverse: bool = False) -> Pose:
        """The pose of something that stands along the road."""
        x, y = self.point(s, lateral)
        return Pose(float(x), float(y), float(self.line.heading(s)) + (np.pi if reverse else 0.0))

    def stations(self, start: float, end: float, step: float = _STEP) -> Array:
        """Arc lengths from start to end, at most `step` apart."""
        return np.linspace(start, end, max(int(np.ceil((end - start) / step)), 1) + 1)

    def carriageway(self) -> shapely.Polygon:
        """Asphalt from kerb to kerb."""
        s = self.stations(*self.paved)
        right = self.point(s, self.section.kerb(-1))
        left = self.point(s, self.section.kerb(1))
        return shapely.Polygon(np.concatenate([right, left[::-1]]))

    def blocks(self) -> Array:
        """Arc lengths (K + 1,) at which lane segments begin and end."""
        count = max(round((self.end - self.start) / self.block), 1)
        return np.linspace(self.start, self.end, count + 1)

    def lane_id(self, block: int, index: int) -> str:
        """Id of a lane segment; index as in `Section.lane`."""
        return f"{self.name}-{block:02d}-{'f' if index > 0 else 'b'}{abs(index)}"

    def lanes(self) -> Iterator[Lane]:
        """All lane segments, linked along and across the road."""
        edges = self.blocks()
        last = len(edges) - 2
        for block in range(last + 1):
            s = self.stations(edges[block], edges[block + 1])
            for index in self._indices():
                inner, outer = self.section.lane(index)
                middle, left, right = (
                    self.point(s, lateral, side=-1 if index > 0 else 1)
                    for lateral in ((inner + outer) / 2, inner, outer)
                )
                ahead = block + 1 if index > 0 else block - 1
                if index < 0:
                    middle, left, right = middle[::-1], left[::-1], right[::-1]
                yield make_lane(
                    self.lane_id(block, index),
                    middle,
                    left,
                    right,
                    self.speed_limit,
                    successors=(self.lane_id(ahead, index),) if 0 <= ahead <= last else (),
                    left_neighbour=self._beside(block, index, -1),
                    right_neighbour=self._beside(block, index, 1),
                )

    def _indices(self) -> list[int]:
        return [*range(1, self.section.forward + 1), *range(-1, -self.section.backward - 1, -1)]

    def _beside(self, block: int, index: int, outwards: int) -> str | None:
        other = index + outwards if index > 0 else index - outwards
        return self.lane_id(block, other) if other in self._indices() else None


def make_lane(
    lane_id: str,
    middle: Array,
    left: Array,
    right: Array,
    speed_limit: float,
    successors: tuple[str, ...] = (),
    left_neighbour: str | None = None,
    right_neighbour: str | None = None,
    is_intersection: bool = False,
) -> Lane:
    """A lane at z = 0 from its three lines (N, 2), all in driving direction."""
    return Lane(
        lane_id=lane_id,
        centreline=np.pad(middle, ((0, 0), (0, 1))),
        left_boundary=np.pad(left, ((0, 0), (0, 1))),
        right_boundary=np.pad(right, ((0, 0), (0, 1))),
        polygon=np.concatenate([right, left[::-1]]),
        speed_limit=speed_limit,
        successors=successors,
        left_neighbour=left_neighbour,
        right_neighbour=right_neighbour,
        is_intersection=is_intersection,
    )


@dataclass(frozen=True)
class Wear:
    """How worn a road is."""

    colour: tuple[float, float, float] = (0.115, 0.115, 0.118)  # linear RGB of the asphalt
    # patches, cracks, covers: number of each in a hundred metres of lane.
    patches: float = 3.0
    cracks: float = 9.0
    covers: float = 2.5
    tracks: float = 1.0  # 1 shows plain wheel tracks, 0 none


def wear_road(decals: Decals, road: Road, wear: Wear, rng: Generator) -> None:
    """Wear the lanes of a road down."""
    for index in [*range(1, road.section.forward + 1), *range(-road.section.backward, 0)]:
        low, high = sorted(road.section.lane(index))
        lane = _LaneWear(decals, road, wear, rng, low, high, -int(np.sign(index)))
        lane.tracks()
        lane.patches()
        lane.covers()
        lane.cracks()


def wear_turns(decals: Decals, lanes: list[Lane], wear: Wear, clear: shapely.Geometry) -> None:
    """Tyre tracks through a junction, as one dark shape so that crossing ones do not overlap.

    `clear` is kept free: roads that have tracks of their own.
    """
    strips = []
    for lane in lanes:
        for offset in (0.82, -0.82):
            track = shapely.LineString(lane.centreline[:, :2]).offset_curve(offset)
            strips.append(track.buffer(0.3, cap_style="flat"))
    region = shapely.union_all(strips).difference(clear)
    decals.polygon(region, _TRACKS, np.array(wear.colour) * (1 - 0.13 * wear.tracks), "asphalt")


@dataclass(frozen=True)
class _LaneWear:
    """Wears one lane down, between the laterals `low` and `high` on one side of a road."""

    decals: Decals
    road: Road
    wear: Wear
    rng: Generator
    low: float
    high: float
    side: int

    def _strip(
        self, s: Array, left: ArrayLike, right: ArrayLike, height: float, tone: ArrayLike
    ) -> None:
        one, other = (self.road.point(s, lateral, self.side) for lateral in (left, right))
        self.decals.strip(one, other, height, np.asarray(tone) * self.wear.colour, "asphalt")

    def tracks(self) -> None:
        """Wheel tracks, soft at their edges."""
        start, end = self.road.paved
        s = self.road.stations(start + 0.5, end - 0.5, 5.0)
        drift = (self.low + self.high) / 2 + 0.12 * _wander(len(s), self.rng)
        shade = 1 + 0.05 * _wander(len(s) - 1, self.rng)[:, None]
        for wheel in (0.82, -0.82):
            for (outer, bright), inner in zip(_SOFT, (0.34, 0.18, 0.0), strict=True):
                tone = (1 - self.wear.tracks * (1 - bright)) * shade
                for sign in (1.0, -1.0):
                    far, near = (drift + wheel + sign * reach for reach in (outer, inner))
                    self._strip(s, far, near, _TRACKS, tone)

    def patches(self) -> None:
        """Mended places, some of them trenches along the lane."""
        rng, low, high, end = self.rng, self.low, self.high, self.road.end
        s = self.road.start + rng.uniform(0, 20)
        while self.wear.patches > 0 and s < end - 12:
            if rng.random() < 0.3:  # a trench along the lane
                length, width = rng.uniform(5, 18), rng.uniform(0.5, 0.9)
            else:
                length, width = rng.uniform(0.8, 4.0), rng.uniform(0.7, high - low - 0.4)
            length = min(length, end - s - 1)
            start = rng.uniform(low + 0.1, high - width - 0.1)
            tone = rng.choice([rng.uniform(0.55, 0.8), rng.uniform(1.12, 1.4)])
            stations = self.road.stations(s, s + length)
            self._strip(stations, start + width, start, _PATCHES, tone)
            s += length + rng.exponential(100 / self.wear.patches)

    def covers(self) -> None:
        """Round covers of manholes."""
        rng = self.rng
        s = self.road.start + rng.uniform(3, 40)
        while self.wear.covers > 0 and s < self.road.end - 3:
            middle = (self.low + self.high) / 2 + rng.uniform(-0.5, 0.5)
            centre = shapely.Point(self.road.point(s, middle, self.side))
            for radius, tone, lift in ((0.42, 0.075, 0.0), (0.33, 0.05, 2e-4), (0.2, 0.09, 4e-4)):
                disc = centre.buffer(radius, quad_segs=4)
                colour = [tone, tone * 0.97, tone * 0.93]
                self.decals.polygon(disc, _COVERS + lift, colour, "asphalt")
            s += 8 + rng.exponential(100 / self.wear.covers)

    def cracks(self) -> None:
        """Sealed cracks across and along the lane."""
        rng, low, high = self.rng, self.low, self.high
        s = self.road.start + rng.exponential(8)
        while self.wear.cracks > 0 and s < self.road.end - 12:
            if rng.random() < 0.55:  # across the lane
                lateral = np.linspace(low, high, 9)
                along = s + 0.25 * _wander(9, rng) + rng.uniform(-0.15, 0.15) * np.arange(9)
                width = np.array([rng.uniform(0.012, 0.032), 0.0])
            else:
                along = s + np.linspace(0.0, rng.uniform(3.0, 10.0), 14)
                lateral = np.clip(rng.uniform(low, high) + 0.3 * _wander(14, rng), low, high)
                width = np.array([0.0, rng.uniform(0.012, 0.032)])
            one, other = (
                self.road.point(along + sign * width[0], lateral + sign * width[1], self.side)
                for sign in (1, -1)
            )
            tone = np.array(self.wear.colour) * rng.uniform(0.35, 0.6)
            self.decals.strip(one, other, _SEALS, tone, "asphalt")
            s += rng.exponential(100 / self.wear.cracks)


def _wander(count: int, rng: Generator) -> Array:
    """A smooth random walk (count,) of about unit size."""
    steps = rng.normal(size=count + 8)
    return np.convolve(steps, np.ones(9) / 3.0, mode="valid")
