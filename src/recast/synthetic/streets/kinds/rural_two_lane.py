"""A country road between fields, with gentle bends."""

from __future__ import annotations

import numpy as np
import shapely
from numpy.random import Generator

from recast.synthetic import scenery
from recast.synthetic.streets.dress import line_along, sign, trees, woods
from recast.synthetic.streets.ground import GRASS, GRAVEL, SOIL, Band, Edge
from recast.synthetic.streets.junctions import tee
from recast.synthetic.streets.network import Arm
from recast.synthetic.streets.paint import RoadPaint, paint_arm, paint_road
from recast.synthetic.streets.placement import Prop
from recast.synthetic.streets.reference_line import Pose, ReferenceLine
from recast.synthetic.streets.road import Road, Section
from recast.synthetic.streets.site import EGO_START, RUN_OUT, Layout, Site
from recast.synthetic.streets.triangles import flat
from recast.synthetic.streets.wear import Wear

DRY_GRASS = (0.14, 0.15, 0.05)
EDGE = Edge(
    kerb=False,
    bands=(
        Band(0.9, GRAVEL, "soil", -0.02),
        Band(1.4, GRASS, "grass", -0.25),
        Band(0.9, (0.07, 0.11, 0.03), "grass", -0.30),
        Band(1.8, DRY_GRASS, "grass", 0.0),
    ),
    land=((0.10, 0.14, 0.04), "grass"),
    hills=38.0,
)
CROPS = (
    ((0.26, 0.21, 0.08), "grass"),
    (SOIL, "soil"),
    ((0.07, 0.13, 0.03), "grass"),
    ((0.30, 0.27, 0.05), "grass"),
    ((0.17, 0.17, 0.06), "grass"),
)
SPEED = 16.7


def rural_two_lane(rng: Generator, length: float) -> Site:
    """Build the street."""
    layout_rng, site_rng = rng.spawn(2)
    site = Site(_layout(layout_rng, length), site_rng)
    main, ahead, side = site.road("main"), site.road("ahead"), site.road("side")
    paint_road(site, main, RoadPaint("dashed", dash=4.0, gap=8.0), (False, True))
    paint_road(site, ahead, RoadPaint("dashed", dash=4.0, gap=8.0), (True, False))
    site.markings.line(main, main.end, ahead.start, main.section.lanes_edge(_far(side)), 0.14)
    paint_arm(site, Arm(side, False), "yield", zebra=False)
    sign(site, side, side.start + 1.0, 1, "yield", away=1.5)
    sign(site, main, EGO_START + 20.0, -1, "speed", away=1.5, speed=70)
    sign(site, main, main.end - 45.0, -1, "warning", away=1.5)
    sign(site, main, main.end - 18.0, -1, "direction", away=3.4)
    for road in (main, ahead):
        for way in (1, -1):
            _markers(site, road, way)
    _wires(site, main, ahead)
    _rails(site, main)
    _rails(site, ahead)
    _farm(site, side)
    _fields(site)
    _trees(site, main, ahead)
    woods(site, 0.9, 12.0)
    return site


def _layout(rng: Generator, length: float) -> Layout:
    total = EGO_START + length + RUN_OUT
    way = float(rng.choice([-1.0, 1.0]))
    bends = [
        (EGO_START + 0.1 * length, 0.0),
        (0.45 * length, way / rng.uniform(220, 350)),
        (0.2 * length, 0.0),
        (0.25 * length + 60.0, -way / rng.uniform(200, 320)),
        (RUN_OUT, way / 500.0),
    ]
    line = ReferenceLine.from_bends(Pose(-EGO_START, 0.0, 0.0), bends, 50.0).part(0.0, total)
    section = Section(1, 1, lane_width=float(rng.uniform(3.3, 3.5)), edge=0.45)
    crossing = EGO_START + length * float(rng.uniform(0.5, 0.7)) + 10.0
    minor = Section(1, 1, lane_width=3.2, edge=0.2)
    roads = tee(line, section, minor, crossing, -int(way), SPEED, 8.0, zebra=False)
    wear = Wear((0.15, 0.148, 0.143), patches=3.5, cracks=11.0, covers=0.0, tracks=1.1)
    return Layout(roads.network, roads.route(1), SPEED - 2.7, EDGE, 8.0, wear=wear)


def _far(side: Road) -> int:
    """The side of the main road that faces the side road."""
    return -1 if np.sin(side.line.headings[0]) > 0 else 1


def _markers(site: Site, road: Road, side: int) -> None:
    """Marker posts with reflectors."""
    post = Prop.of(scenery.bollard(site.rng))
    site.row(road, side, [post], 25.0, 0.75)


def _wires(site: Site, main: Road, ahead: Road) -> None:
    side = int(site.rng.choice([-1, 1]))
    for road in (main, ahead):
        line_along(
            site, road, side, 8.5, lambda n: scenery.pole_line(site.rng, n, n), road.paved[0] + 5.0,
            road.paved[1] - 2.0, piece=38.0,
        )  # fmt: skip


def _rails(site: Site, road: Road) -> None:
    """Guard rails along the outside of the sharpest part of each bend."""
    s = np.arange(road.start + 12.0, road.end - 12.0, 8.0)
    turn = np.gradient(road.line.heading(s), s)
    for at, curvature in zip(s, turn, strict=True):
        if abs(curvature) > 1 / 360:
            side = -int(np.sign(curvature))
            line_along(
                site, road, side, 1.1, lambda n: scenery.guard_rail(site.rng, n), at, at + 8.0, 9.0
            )


def _farm(site: Site, side: Road) -> None:
    rng = site.rng
    way = int(rng.choice([-1, 1]))
    for away, along, style, width, depth in (
        (9.0, 40.0, "suburban", 12.0, 9.0),
        (12.0, 66.0, "industrial", 26.0, 20.0),
    ):
        pose = site.beside(side, along, way, away)
        site.placer.place(Prop.of(scenery.building(rng, width, depth, style)), pose)
    line_along(site, side, -way, 4.5, lambda n: scenery.fence(rng, n, "wood"), 22.0, 88.0)


def _fields(site: Site) -> None:
    """Crops in wide patches on both sides, a hand above the land."""
    rng = site.rng
    clear = site.ground.filled.buffer(EDGE.width + 1.0)
    near = site.ground.filled.buffer(110.0)
    low_x, low_y, high_x, high_y = near.bounds
    xs = np.arange(low_x, high_x, 75.0) + rng.uniform(-12, 12)
    ys = np.array([low_y, (low_y + high_y) / 2 + rng.uniform(-8, 8), high_y])
    for k in range(len(xs)):
        for j in range(len(ys) - 1):
            right = xs[k + 1] if k + 1 < len(xs) else high_x
            patch = shapely.box(xs[k] + 2.0, ys[j] + 2.0, right - 2.0, ys[j + 1] - 2.0)
            patch = shapely.affinity.skew(patch, xs=float(rng.uniform(-12, 12)))
            colour, material = CROPS[int(rng.integers(len(CROPS)))]
            region = patch.intersection(near).difference(clear)
            height = 0.02 + 0.004 * float(rng.random()) + 0.006 * ((k + j) % 2)
            site.extras.append(flat(region, height, colour, material))


def _trees(site: Site, main: Road, ahead: Road) -> None:
    rng = site.rng
    crowns = trees(rng, (7.0, 11.0), ("round", "round", "conifer", "tall"), 6)
    far = trees(rng, (8.0, 13.0), ("conifer", "round", "conifer"), 4, detail=0.5)
    bushes = [Prop.of(scenery.bush(rng, float(rng.uniform(0.8, 1.6)))) for _ in range(4)]
    for road in (main, ahead):
        for way in (1, -1):
            site.row(road, way, crowns, 26.0, 7.0, jitter=9.0, turn=None, chance=0.55)
            site.row(road, way, bushes, 11.0, 5.6, jitter=4.0, turn=None, chance=0.5)
            for away, chance in ((26.0, 0.3), (48.0, 0.5), (78.0, 0.6)):
                site.row(road, way, far, 22.0, away, jitter=18.0, turn=None, chance=chance)
