"""How whole roads and junctions are marked."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Literal

import numpy as np

from recast.synthetic.streets.markings import WHITE, YELLOW, ArrowKind
from recast.synthetic.streets.network import Arm
from recast.synthetic.streets.road import Road
from recast.synthetic.streets.site import Site
from recast.synthetic.world import ParkingSpot

CentreLine = Literal["dashed", "solid", "double", "none"]
Control = Literal["stop", "yield", "none"]


@dataclass(frozen=True)
class RoadPaint:
    """Lines of a road.

    Attributes:
        centre: between the directions.
        edges: solid lines along the outer edges of the lanes.
        yellow: the centre line is yellow.
        solid: metres before `start` and `end` arms in which dividers are not broken.
        dash, gap: metres, of broken lines.
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
    if section.median > 0.5 or road.spread:
        for side in (1, -1):
            if section.median > 0.5:
                lateral = side * (section.median / 2 + 0.02)
                marks.line(road, start, end, lateral, colour=colour)
    elif paint.centre == "double" or paint.centre == "solid":
        for lateral in (0.11, -0.11) if paint.centre == "double" else (0.0,):
            marks.line(road, start, end, lateral, colour=colour, side=0)
    elif paint.centre == "dashed":
        marks.dashes(road, *free, 0.0, paint.dash, paint.gap, colour=colour)
        for a, b in ((start, free[0]), (free[1], end)):
            marks.line(road, a, b, 0.0, colour=colour)
    for side, count in ((1, section.backward), (-1, section.forward)):
        for k in range(1, count):
            lateral = side * (section.median / 2 + k * section.lane_width)
            marks.dashes(road, *free, lateral, paint.dash, paint.gap, side=side)
            for a, b in ((start, free[0]), (free[1], end)):
                marks.line(road, a, b, lateral, side=side)
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
    arm: Arm,
    control: Control,
    zebra: bool,
    arrows: Sequence[ArrowKind] = (),
) -> None:
    """Stop or give-way line, crossing and arrows where a road meets a junction.

    Args:
        site: the street.
        arm: the road's end.
        control: line across the incoming lanes.
        zebra: a pedestrian crossing beyond the line.
        arrows: of the incoming lanes, from the middle outwards.
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
        site: the street.
        road: has a parking lane on that side.
        side: +1 left, -1 right.
        middles: arc lengths of places, see `bays`.
        share: of the places that are spots.
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
