"""Rows of buildings, trees, lamps and furniture along roads."""

from __future__ import annotations

import itertools
from collections.abc import Callable
from dataclasses import dataclass

import numpy as np
import shapely
from numpy.random import Generator

from recast.synthetic import scenery
from recast.synthetic.streets.ground import KERB_HEIGHT, Colour, forest_belt
from recast.synthetic.streets.road import Road
from recast.synthetic.streets.shapes import Pose, placed
from recast.synthetic.streets.site import Prop, Site
from recast.synthetic.surface import Surface


@dataclass(frozen=True)
class Frontage:
    """A row of buildings.

    Attributes:
        style: see `scenery.building`.
        away: metres from the kerb to the facades; a range.
        width, depth: metres; ranges.
        gap: metres between buildings; a range.
        storeys: a range, or None to leave it to the style.
    """

    style: str
    away: tuple[float, float]
    width: tuple[float, float]
    depth: tuple[float, float]
    gap: tuple[float, float] = (0.0, 0.0)
    storeys: tuple[int, int] | None = None


def build_along(
    site: Site, road: Road, side: int, frontage: Frontage, start: float, end: float
) -> list[tuple[float, float]]:
    """Buildings along one side of a road; returns the arc lengths (start, end) of each."""
    rng, built = site.rng, []
    s = start
    while s < end - frontage.width[0]:
        width = float(rng.uniform(*frontage.width))
        depth, away = float(rng.uniform(*frontage.depth)), float(rng.uniform(*frontage.away))
        pose = site.beside(road, s + width / 2, side, away)
        body = shapely.box(-width / 2, 0, width / 2, depth)
        if site.ground.filled.intersects(placed(body, pose)):
            s += 3.0
            continue
        storeys = None if frontage.storeys is None else int(rng.integers(*frontage.storeys))
        house = scenery.building(rng, width, depth, frontage.style, storeys)
        if site.placer.place(Prop.of(house), pose, site.core, overlap=0.1):
            built.append((s, s + width))
            s += width + float(rng.uniform(*frontage.gap))
        else:
            s += 3.0
    return built


def several(rng: Generator, make: Callable[[Generator], Surface], count: int) -> list[Prop]:
    """`count` variants of something."""
    return [Prop.of(make(rng)) for _ in range(count)]


def trees(
    rng: Generator,
    height: tuple[float, float],
    styles: tuple[str, ...] = ("round",),
    count: int = 5,
    detail: float = 1.0,
) -> list[Prop]:
    """Variants of trees."""
    made = []
    for k in range(count):
        style = styles[k % len(styles)]
        made.append(Prop.of(scenery.tree(rng, float(rng.uniform(*height)), style, detail)))
    return made


def lamps(
    site: Site, road: Road, sides: tuple[int, ...], spacing: float, height: float, reach: float
) -> None:
    """Lamp posts, on both sides in turn where there are two."""
    prop = Prop.of(scenery.lamp_post(site.rng, height, reach))
    for k, side in enumerate(sides):
        begin = road.start + spacing * (0.2 + k / max(len(sides), 1))
        for s in np.arange(begin, road.end, spacing):
            for shift in (0.0, 2.0, -2.0, 4.0, -4.0):
                pose = site.beside(road, float(s) + shift, side, 0.55)
                if site.placer.place(prop, pose):
                    break


def sign(
    site: Site, road: Road, s: float, side: int, kind: str, away: float = 0.7, speed: int = 50
) -> bool:
    """A sign for the traffic on one side of a road; tries a few places nearby."""
    prop = Prop.of(scenery.road_sign(site.rng, kind, speed))
    for shift in (0.0, 1.5, -1.5, 3.0, -3.0, 5.0):
        spot = site.beside(road, s + shift, side, away)
        heading = float(road.line.heading(s + shift)) + (np.pi if side > 0 else 0.0)
        if site.placer.place(prop, Pose(spot.x, spot.y, heading)):
            return True
    return False


def joints(site: Site, road: Road, side: int, width: float, pitch: float = 1.9) -> None:
    """Dark joints between the slabs of a pavement that begins at the kerb."""
    height = KERB_HEIGHT - 0.0008
    kerb = road.section.kerb(side)
    tone = [0.17, 0.165, 0.15]
    covered = site.ground.filled.buffer(0.16)
    for s in np.arange(road.paved[0] + 1, road.paved[1] - 1, pitch):
        lateral = kerb + side * np.array([0.18, width - 0.1])
        ends = road.point(np.full(2, s), lateral)
        if not covered.disjoint(shapely.LineString(ends)):
            continue
        one = road.point(np.full(2, s + 0.012), lateral)
        other = road.point(np.full(2, s - 0.012), lateral)
        site.decals.strip(one, other, height, tone, "concrete")
    s = road.stations(road.paved[0] + 1, road.paved[1] - 1, 4.0)
    for out in np.arange(1.3, width - 0.4, 1.3):
        one = road.point(s, kerb + side * (out + 0.012))
        other = road.point(s, kerb + side * (out - 0.012))
        pieces = shapely.linestrings(np.stack([one[:-1], one[1:]], 1))
        for k in np.flatnonzero(~shapely.intersects(covered, pieces)):
            site.decals.strip(one[k : k + 2], other[k : k + 2], height, tone, "concrete")


def line_along(
    site: Site,
    road: Road,
    side: int,
    away: float,
    make: Callable[[float], Surface],
    start: float,
    end: float,
    piece: float = 8.0,
    share: float = 1.0,
) -> None:
    """Hedges, fences, rails or walls along a road, in straight pieces.

    Args:
        side: +1 left, -1 right.
        away: metres outside the kerb.
        make: function that makes a piece, along x, from its length in metres.
        start, end: arc lengths.
        piece: metres of a piece, about.
        share: share of the pieces that are there.
    """
    if end - start < 1.5:
        return
    lateral = road.section.kerb(side) + side * away
    edges = road.stations(start, end, piece)
    for a, b in itertools.pairwise(road.point(edges, lateral)):
        if side < 0:
            a, b = b, a
        if site.rng.random() >= share:
            continue
        heading = float(np.arctan2(b[1] - a[1], b[0] - a[0]))
        prop = Prop.of(make(float(np.hypot(*(b - a)))))
        site.placer.place(prop, Pose(float(a[0]), float(a[1]), heading), overlap=0.3)


def driveway(
    site: Site, road: Road, s: float, side: int, width: float, depth: float, colour: Colour
) -> None:
    """A paved way from the kerb to a plot."""
    laterals = road.section.kerb(side) + side * np.array([0.02, depth])
    ends = np.array([s - width / 2, s + width / 2])
    corners = np.stack([road.point(np.full(2, e), laterals) for e in ends])
    outline = shapely.Polygon([corners[0, 0], corners[1, 0], corners[1, 1], corners[0, 1]])
    outline = outline.difference(site.ground.filled)
    site.decals.polygon(outline, KERB_HEIGHT + 0.004, colour, "concrete")
    site.placer.reserve(outline)


def woods(site: Site, share: float, height: float = 11.0) -> None:
    """Belts of trees around the site, far off, over a share of the horizon."""
    low_x, low_y, high_x, high_y = site.ground.filled.bounds
    centre = np.array([(low_x + high_x) / 2, (low_y + high_y) / 2])
    radius = float(np.hypot(high_x - low_x, high_y - low_y)) / 2 + 75.0
    angle = float(site.rng.uniform(0, 2 * np.pi))
    end = angle + 2 * np.pi
    while angle < end:
        turn = float(site.rng.uniform(0.2, 0.7))
        if site.rng.random() < share:
            tall = height * float(site.rng.uniform(0.7, 1.3))
            away = radius + float(site.rng.uniform(-15.0, 10.0))
            site.extras.append(forest_belt(centre, away, angle, turn, tall, site.rng))
        angle += turn


def close_view(site: Site, road: Road, s: float, ahead: int, frontage: Frontage) -> None:
    """A building across the end of a road, so that one does not look into nothing."""
    width = min(max(2 * abs(road.section.kerb(1)) + 8, frontage.width[0]), 48.0)
    depth = float(site.rng.uniform(*frontage.depth))
    storeys = None if frontage.storeys is None else int(site.rng.integers(*frontage.storeys))
    spot = road.line.pose(s + ahead * 5.5)
    heading = spot.heading + (-np.pi / 2 if ahead > 0 else np.pi / 2)
    house = scenery.building(site.rng, width, depth, frontage.style, storeys)
    site.placer.place(Prop.of(house), Pose(spot.x, spot.y, heading), overlap=0.3)
