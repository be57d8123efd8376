"""Painted lines, crossings and arrows, thin shapes 4 mm above the asphalt, along whole roads."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import TYPE_CHECKING, Any, Literal

import numpy as np
import shapely
from numpy.random import Generator

from recast.arrays import Array
from recast.synthetic.streets.network import JunctionArm
from recast.synthetic.streets.road import Road
from recast.synthetic.streets.shapes import Decals, Pose, placed
from recast.synthetic.world import ParkingSpot

if TYPE_CHECKING:
    from recast.synthetic.streets.site import Site

ArrowKind = Literal["straight", "left", "right", "straight-left", "straight-right"]

HEIGHT = 0.004
WHITE = np.array([0.62, 0.62, 0.60])
YELLOW = np.array([0.62, 0.44, 0.06])

_HEAD = [(4.0, 0.0), (2.6, 0.42), (2.6, -0.42)]
_STEM = [(0.0, 0.075), (0.0, -0.075), (2.65, -0.075), (2.65, 0.075)]
_HOOK_STEM = [(0.0, 0.075), (0.0, -0.075), (1.9, -0.075), (2.6, 0.45), (2.4, 0.6), (1.7, 0.075)]
_HOOK_HEAD = [(3.05, 1.0), (2.15, 0.85), (2.85, 0.2)]
CentreLine = Literal["dashed", "solid", "double", "none"]
Control = Literal["stop", "yield", "none"]


class Markings:
    """Paints onto roads.

    Attributes:
        decals: decals that the shapes are added to.
        rng: random generator of how worn each piece of paint is.
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
            laterals = [middle - 0.25, middle + 0.25, middle]
            corners = road.point([s, s, s - towards * 0.6], laterals, side)
            self.decals.add(corners, HEIGHT, self._paint(WHITE, 1), "marking")

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
        self.decals.polygon(placed(whole, pose), HEIGHT, self._paint(WHITE, 1)[0], "marking")

    def _box(
        self, road: Road, start: float, end: float, near: float, far: float, side: int | None = None
    ) -> None:
        low, high = sorted((near, far))
        left, right = (road.point([start, end], lateral, side) for lateral in (high, low))
        self.decals.strip(left, right, HEIGHT, self._paint(WHITE, 1), "marking")

    def _paint(self, colour: Array, count: int) -> Array:
        return colour * self._wear * self.rng.uniform(0.86, 1.0, (count, 1))


@dataclass(frozen=True)
class RoadPaint:
    """Lines of a road.

    Attributes:
        centre: kind of the centre line, between the directions.
        edges: solid lines along the outer edges of the lanes.
        yellow: the centre line is yellow.
        solid: metres before `start` and `end` arms in which dividers are not broken.
        dash, gap: lengths in metres of the dashes and gaps of broken lines.
        bays: ticks between parking spots.
    """

    centre: CentreLine = "dashed"
    edges: bool = True
    yellow: bool = False
    solid: float = 22.0
    dash: float = 3.0
    gap: float = 6.0
    bays: bool = True


def paint_road(site: Site, road: Road, paint: RoadPaint, solid_ends: tuple[bool, bool]) -> None:
    """Lines along a road; `solid_ends` tells at which ends (start, end) traffic must keep lane."""
    section, marks = road.section, site.markings
    start, end = road.start, road.end
    if not solid_ends[0]:
        start = road.paved[0]
    if not solid_ends[1]:
        end = road.paved[1]
    free = (start + paint.solid * solid_ends[0], end - paint.solid * solid_ends[1])
    colour = YELLOW if paint.yellow else WHITE

    def broken(lateral: float, **options: Any) -> None:
        marks.dashes(road, *free, lateral, paint.dash, paint.gap, **options)
        for a, b in ((start, free[0]), (free[1], end)):
            marks.line(road, a, b, lateral, **options)

    if section.median > 0.5:
        for side in (1, -1):
            marks.line(road, start, end, side * (section.median / 2 + 0.02), colour=colour)
    centre = "none" if section.median > 0.5 or road.spread else paint.centre
    if centre == "double" or centre == "solid":
        for lateral in (0.11, -0.11) if centre == "double" else (0.0,):
            marks.line(road, start, end, lateral, colour=colour, side=0)
    elif centre == "dashed":
        broken(0.0, colour=colour)
    for side, count in ((1, section.backward), (-1, section.forward)):
        for k in range(1, count):
            broken(side * (section.median / 2 + k * section.lane_width), side=side)
        if paint.edges:
            lateral = section.lanes_edge(side) + side * 0.02
            marks.line(road, start, end, lateral, 0.14, side=side)


def paint_through(site: Site, before: Road, after: Road) -> None:
    """Broken dividers between the lanes of a through road across a junction."""
    section = before.section
    for side, count in ((1, section.backward), (-1, section.forward)):
        for k in range(1, count):
            lateral = side * (section.median / 2 + k * section.lane_width)
            site.markings.dashes(before, before.end + 3, after.start, lateral, 1.5, 3.0)
        if section.median > 0.5:
            lateral = side * (section.median / 2 + 0.02)
            site.markings.line(before, before.end, after.start, lateral)


def paint_arm(
    site: Site,
    arm: JunctionArm,
    control: Control,
    zebra: bool,
    arrows: Sequence[ArrowKind] = (),
) -> None:
    """Stop or give-way line, crossing and arrows where a road meets a junction.

    Args:
        arm: the road's end.
        control: line across the incoming lanes.
        zebra: a pedestrian crossing beyond the line.
        arrows: arrows of the incoming lanes, from the middle outwards.
    """
    road, section, marks = arm.road, arm.road.section, site.markings
    towards = 1 if arm.at_end else -1
    s = road.end if arm.at_end else road.start
    side = -towards
    near = side * (section.median / 2 + 0.15)
    far = section.lanes_edge(side) - side * 0.05
    if control == "stop":
        marks.across(road, s - towards * 0.3, near, far, side=side)
    elif control == "yield":
        marks.teeth(road, s - towards * 0.2, near, far, towards, side)
    if zebra:
        marks.zebra(road, s + towards * 2.8)
    for k, kind in enumerate(arrows):
        inner, outer = section.lane(towards * (k + 1))
        for back in (9.0, 26.0):
            at = s - towards * back
            pose = road.pose(at, (inner + outer) / 2, reverse=towards < 0)
            marks.arrow(pose, kind)


def bays(start: float, end: float, pitch: float, block: int) -> tuple[list[float], list[float]]:
    """Middles of parking places along a road, and of those left out: each after `block` places."""
    middles = np.arange(start, end - pitch, pitch) + pitch / 2
    out = [k % (block + 1) == block for k in range(len(middles))]
    kept = [float(s) for s, skip in zip(middles, out, strict=True) if not skip]
    return kept, [float(s) for s, skip in zip(middles, out, strict=True) if skip]


def park_along(
    site: Site,
    road: Road,
    side: int,
    middles: Sequence[float],
    share: float = 1.0,
    pitch: float = 6.1,
    length: float = 5.4,
    ticks: bool = True,
) -> None:
    """Parking spots in the parking lane of a road.

    Args:
        road: road with a parking lane on that side.
        side: +1 left, -1 right.
        middles: arc lengths of places, see `bays`.
        share: share of the places that are spots.
        pitch: metres from one place to the next.
        length: metres that a vehicle may have.
        ticks: painted between places.
    """
    section = road.section
    depth = section.parking_left if side > 0 else section.parking_right
    middle = section.lanes_edge(side) + side * (depth / 2 + 0.12)
    for s in middles:
        if site.rng.random() < share:
            pose = road.pose(s, middle, reverse=side > 0)
            site.parking.append(ParkingSpot(pose.x, pose.y, float(pose.heading), length))
        if ticks:
            inner = section.lanes_edge(side) + side * 0.15
            for at in (s - pitch / 2, s + pitch / 2):
                site.markings.across(road, at, inner, section.kerb(side), width=0.1, side=side)
