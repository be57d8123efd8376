"""A wide arterial road: three lanes each way, a planted median, offices set back from it."""

from __future__ import annotations

import numpy as np
import shapely
from numpy.random import Generator

from recast.synthetic import scenery
from recast.synthetic.streets.dress import (
    Frontage,
    build_along,
    lamps,
    several,
    sign,
    trees,
    woods,
)  # fmt: skip
from recast.synthetic.streets.ground import GRASS, PAVING, Band, Edge, Island
from recast.synthetic.streets.junctions import tee
from recast.synthetic.streets.network import Arm
from recast.synthetic.streets.paint import RoadPaint, paint_arm, paint_road, paint_through
from recast.synthetic.streets.reference_line import Pose, ReferenceLine
from recast.synthetic.streets.road import Road, Section
from recast.synthetic.streets.site import EGO_START, RUN_OUT, Layout, Site

EDGE = Edge(
    kerb=True,
    bands=(Band(2.4, GRASS, "grass"), Band(2.6, PAVING, "concrete")),
    land=(GRASS, "grass"),
)
OFFICES = Frontage("office", (12.0, 18.0), (24.0, 46.0), (15.0, 24.0), (8.0, 22.0))
SPEED = 16.7


def arterial_median(rng: Generator, length: float) -> Site:
    """Build the street."""
    layout_rng, site_rng = rng.spawn(2)
    site = Site(_layout(layout_rng, length), site_rng)
    main, ahead, side = site.road("main"), site.road("ahead"), site.road("side")
    paint_road(site, main, RoadPaint(solid=0.0), (False, True))
    paint_road(site, ahead, RoadPaint(solid=0.0), (True, False))
    paint_through(site, main, ahead)
    paint_road(site, side, RoadPaint("solid", solid=12), (True, False))
    paint_arm(site, Arm(side, False), "yield", zebra=False)
    for way in (1, -1):
        build_along(site, main, way, OFFICES, main.paved[0], ahead.paved[1])
    _furnish(site, main, ahead)
    _plant_median(site, main, ahead)
    woods(site, 0.7, 14.0)
    return site


def _layout(rng: Generator, length: float) -> Layout:
    total = EGO_START + length + RUN_OUT
    bend = float(rng.uniform(-1, 1)) / 900
    line = ReferenceLine.from_bends(
        Pose(-EGO_START, 0.0, 0.0),
        [(EGO_START + 0.5 * length, 0.0), (0.5 * length + 60, bend), (RUN_OUT - 60, 0.0)],
        transition=60.0,
    )
    section = Section(3, 3, lane_width=3.5, median=float(rng.uniform(4.5, 6.0)), edge=0.5)
    crossing = EGO_START + length * float(rng.uniform(0.6, 0.8)) + 15.0
    roads = tee(
        line, section, Section(1, 1, lane_width=3.3, edge=0.4), crossing, -1, SPEED, fillet=9.0,
        zebra=False, barred=[("ahead", "side"), ("side", "main")],
    )  # fmt: skip
    main = roads.main
    s = main.stations(6.0, total - 6.0)
    half_median = section.median / 2 - 0.35
    rim = np.concatenate([main.point(s, -half_median), main.point(s, half_median)[::-1]])
    median = shapely.Polygon(rim).buffer(-0.3).buffer(0.3)
    islands = (Island(median, GRASS, "grass"),)
    return Layout(roads.network, roads.route(2), SPEED - 2.5, EDGE, 9.0, islands)


def _furnish(site: Site, main: Road, ahead: Road) -> None:
    rng = site.rng
    sign(site, main, main.end - 60.0, -1, "direction", away=2.6)
    sign(site, main, EGO_START + 12.0, -1, "speed", speed=60)
    sign(site, ahead, ahead.start + 14.0, -1, "speed", speed=60)
    sign(site, ahead, ahead.start + 40.0, 1, "direction", away=2.6)
    crowns = trees(rng, (7.0, 9.0), ("round", "tall"), 5)
    boards = several(rng, scenery.hoarding, 2)
    small = [*several(rng, scenery.litter_bin, 1), *several(rng, scenery.bench, 1)]
    bushes = several(rng, scenery.bush, 3)
    for road in (main, ahead):
        lamps(site, road, (1, -1), 40.0, 10.0, 2.5)
        for way in (1, -1):
            site.row(road, way, crowns, 22.0, 6.8, jitter=4.0, turn=None, chance=0.7)
            site.row(road, way, boards, 110.0, 7.0, jitter=20.0)
            site.row(road, way, small, 60.0, 4.4, jitter=15.0)
            site.row(road, way, bushes, 17.0, 9.0, jitter=8.0, turn=None, chance=0.6)


def _plant_median(site: Site, main: Road, ahead: Road) -> None:
    rng = site.rng
    crowns = trees(rng, (6.0, 7.5), ("tall", "round"), 4, detail=0.8)
    hedge = several(rng, lambda r: scenery.bush(r, 0.9), 3)
    inside = -main.section.kerb(1)
    for way_road in (main, ahead):
        site.row(way_road, 1, crowns, 20.0, inside, jitter=1.0, turn=None, chance=0.9)
        site.row(way_road, 1, hedge, 9.0, inside, jitter=1.5, turn=None, chance=0.7)
