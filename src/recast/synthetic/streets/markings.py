"""Painted lines, crossings and arrows: thin shapes 4 mm above the asphalt."""

from __future__ import annotations

from typing import Literal

import numpy as np
import shapely
from numpy.random import Generator
from numpy.typing import NDArray

from recast.synthetic.streets.reference_line import Pose
from recast.synthetic.streets.road import Road
from recast.synthetic.streets.triangles import Decals

Array = NDArray[np.float64]
ArrowKind = Literal["straight", "left", "right", "straight-left", "straight-right"]

HEIGHT = 0.004
WHITE = np.array([0.62, 0.62, 0.60])
YELLOW = np.array([0.62, 0.44, 0.06])

_HEAD = [(4.0, 0.0), (2.6, 0.42), (2.6, -0.42)]
_STEM = [(0.0, 0.075), (0.0, -0.075), (2.65, -0.075), (2.65, 0.075)]
_HOOK_STEM = [(0.0, 0.075), (0.0, -0.075), (1.9, -0.075), (2.6, 0.45), (2.4, 0.6), (1.7, 0.075)]
_HOOK_HEAD = [(3.05, 1.0), (2.15, 0.85), (2.85, 0.2)]


class Markings:
    """Paints onto roads.

    Attributes:
        decals: where the shapes go.
        rng: how worn each piece of paint is.
    """

    def __init__(self, decals: Decals, rng: Generator) -> None:
        self.decals = decals
        self.rng = rng
        self._wear = rng.uniform(0.75, 1.0)

    def line(
        self,
        road: Road,
        start: float,
        end: float,
        lateral: float,
        width: float = 0.12,
        colour: Array = WHITE,
        side: int | None = None,
    ) -> None:
        """A solid line along the road."""
        if end - start < 0.3:
            return
        s = road.stations(start, end)
        left, right = (
            road.point(s, lateral + half, side if side is not None else int(np.sign(lateral)))
            for half in (width / 2, -width / 2)
        )
        self.decals.strip(left, right, HEIGHT, self._paint(colour, len(s) - 1), "marking")

    def dashes(
        self,
        road: Road,
        start: float,
        end: float,
        lateral: float,
        dash: float = 3.0,
        gap: float = 6.0,
        width: float = 0.12,
        colour: Array = WHITE,
        side: int | None = None,
    ) -> None:
        """A broken line along the road."""
        for s in np.arange(start, end - dash / 2, dash + gap):
            self.line(road, s, min(s + dash, end), lateral, width, colour, side)

    def across(
        self, road: Road, s: float, near: float, far: float, width: float = 0.4, side: int = 0
    ) -> None:
        """A stop line at s between two laterals."""
        self._box(road, s - width / 2, s + width / 2, near, far, side)

    def zebra(self, road: Road, s: float, length: float = 3.5, bar: float = 0.5) -> None:
        """A crossing from kerb to kerb, its bars along the traffic; s is its middle."""
        left, right = road.section.kerb(1) - 0.3, road.section.kerb(-1) + 0.3
        count = int((left - right - bar) / (2 * bar)) + 1
        first = (left + right) / 2 - (count - 1) * bar
        island = float(road.apart(s)) > 0.5 or road.section.median > 1.0
        for k in range(count):
            middle = first + 2 * bar * k
            if island and abs(middle) < road.section.median / 2 + 0.4:
                continue
            self._box(road, s - length / 2, s + length / 2, middle - bar / 2, middle + bar / 2)

    def teeth(self, road: Road, s: float, near: float, far: float, towards: int, side: int) -> None:
        """A row of give-way triangles at s that point at traffic driving `towards` (+1, -1)."""
        low, high = sorted((near, far))
        count = max(int((high - low) / 0.75), 1)
        middles = low + (np.arange(count) + 0.5) * (high - low) / count
        for middle in middles:
            s_points = np.array([s, s, s - towards * 0.6])
            laterals = np.array([middle - 0.25, middle + 0.25, middle])
            corners = road.point(s_points, laterals, side)
            self.decals.add(_turned(corners), HEIGHT, self._paint(WHITE, 1), "marking")

    def hatching(self, region: shapely.Geometry, heading: float) -> None:
        """Diagonal bars over a painted island, and its outline."""
        if region.is_empty:
            return
        low_x, low_y, high_x, high_y = region.bounds
        middle = np.array([(low_x + high_x) / 2, (low_y + high_y) / 2])
        reach = float(np.hypot(high_x - low_x, high_y - low_y))
        along = np.array([np.cos(heading + 0.8), np.sin(heading + 0.8)])
        step = np.array([np.cos(heading), np.sin(heading)])
        bars = [
            shapely.LineString(
                [middle + k * step - reach * along, middle + k * step + reach * along]
            )
            for k in np.arange(-reach / 2, reach / 2, 1.6)
        ]
        painted = shapely.union_all(shapely.buffer(bars, 0.22, cap_style="flat"))
        painted = shapely.intersection(painted, region.buffer(-0.1))
        painted = shapely.union_all([painted, region.difference(region.buffer(-0.12))])
        self.decals.polygon(painted, HEIGHT, WHITE * self._wear, "marking")

    def arrow(self, pose: Pose, kind: ArrowKind) -> None:
        """An arrow, 4 m long, that begins at the pose and shows where to drive on."""
        shapes = []
        if kind != "left" and kind != "right":
            shapes += [_STEM, _HEAD]
        for way, sign in (("left", 1.0), ("right", -1.0)):
            if kind.endswith(way):
                shapes += [
                    [(x, sign * y) for x, y in points] for points in (_HOOK_STEM, _HOOK_HEAD)
                ]
        whole = shapely.union_all([shapely.Polygon(points) for points in shapes])
        c, s = np.cos(pose.heading), np.sin(pose.heading)
        turn = np.array([[c, -s], [s, c]])
        placed = shapely.transform(whole, lambda xy: xy @ turn.T + np.array(pose[:2]))
        self.decals.polygon(placed, HEIGHT, self._paint(WHITE, 1)[0], "marking")

    def _box(
        self, road: Road, start: float, end: float, near: float, far: float, side: int | None = None
    ) -> None:
        low, high = sorted((near, far))
        s = np.array([start, end])
        self.decals.strip(
            road.point(s, high, side), road.point(s, low, side), HEIGHT, self._paint(WHITE, 1),
            "marking",
        )  # fmt: skip

    def _paint(self, colour: Array, count: int) -> Array:
        return colour * self._wear * self.rng.uniform(0.86, 1.0, (count, 1))


def _turned(corners: Array) -> Array:
    """A triangle (3, 2), counter-clockwise."""
    a, b = corners[1] - corners[0], corners[2] - corners[0]
    return corners if a[0] * b[1] - a[1] * b[0] > 0 else corners[::-1]
