"""Roads: a cross-section swept along a reference line."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass

import numpy as np
import shapely
from numpy.typing import ArrayLike, NDArray

from recast.logs import Lane
from recast.synthetic.streets.reference_line import Pose, ReferenceLine

Array = NDArray[np.float64]

_STEP = 2.0
"""Metres between points of lanes."""


@dataclass(frozen=True)
class Section:
    """What lies across a road, from the reference line outwards; traffic keeps right.

    Attributes:
        forward, backward: lanes along and against the line (right and left of it).
        lane_width: metres.
        median: metres between the two directions.
        parking_right, parking_left: metres of the parking lane, 0 for none.
        edge: metres between the outermost lane (or parking) and the kerb.
    """

    forward: int
    backward: int
    lane_width: float = 3.4
    median: float = 0.0
    parking_right: float = 0.0
    parking_left: float = 0.0
    edge: float = 0.3

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
    """A section along a part of a reference line.

    Attributes:
        name: first part of its lane ids.
        line: in the direction of the forward lanes.
        section: what lies across.
        start, end: arc lengths between which there are lanes.
        speed_limit: m/s.
        paved: arc lengths between which there is asphalt, (start, end) or beyond.
        spread: (arc length, metres) knots; both directions move apart by that much to each side.
        block: metres that a lane segment is long, about.
    """

    name: str
    line: ReferenceLine
    section: Section
    start: float
    end: float
    speed_limit: float
    paved: tuple[float, float]
    spread: tuple[tuple[float, float], ...] = ()
    block: float = 45.0

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
        moved: Array = metres[k] + (metres[k + 1] - metres[k]) * u * u * (3 - 2 * u)
        return moved

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
        centreline=_on_ground(middle),
        left_boundary=_on_ground(left),
        right_boundary=_on_ground(right),
        polygon=np.concatenate([right, left[::-1]]),
        speed_limit=speed_limit,
        successors=successors,
        left_neighbour=left_neighbour,
        right_neighbour=right_neighbour,
        is_intersection=is_intersection,
    )


def _on_ground(points: Array) -> Array:
    return np.concatenate([points, np.zeros((len(points), 1))], axis=1)
