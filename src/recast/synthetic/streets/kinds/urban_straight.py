"""A straight street between blocks of houses, two lanes each way, with a side street."""

from __future__ import annotations

from numpy.random import Generator

from recast.synthetic import scenery
from recast.synthetic.streets.dress import (
    Frontage,
    build_along,
    close_view,
    joints,
    lamps,
    several,
    sign,
    trees,
    woods,
)  # fmt: skip
from recast.synthetic.streets.ground import PAVING, Band, Edge
from recast.synthetic.streets.junctions import tee
from recast.synthetic.streets.network import Arm
from recast.synthetic.streets.paint import RoadPaint, paint_arm, paint_road
from recast.synthetic.streets.reference_line import Pose, ReferenceLine
from recast.synthetic.streets.road import Road, Section
from recast.synthetic.streets.site import EGO_START, RUN_OUT, Layout, Site

EDGE = Edge(
    kerb=True, bands=(Band(4.6, PAVING, "concrete"),), land=((0.25, 0.24, 0.22), "concrete")
)
HOUSES = Frontage("urban", (4.8, 5.0), (10.0, 20.0), (10.0, 14.0), (0.0, 0.0), (3, 6))
SPEED = 13.9


def urban_straight(rng: Generator, length: float) -> Site:
    """Build the street."""
    layout_rng, site_rng = rng.spawn(2)
    site = Site(_layout(layout_rng, length), site_rng)
    main, ahead, side = site.road("main"), site.road("ahead"), site.road("side")
    paint = RoadPaint("double", edges=False)
    paint_road(site, main, paint, (False, True))
    paint_road(site, ahead, paint, (True, False))
    paint_road(site, side, RoadPaint("dashed", edges=False, solid=12), (True, False))
    paint_arm(site, Arm(main, True), "none", zebra=True)
    paint_arm(site, Arm(side, False), "yield", zebra=False)
    for road in (main, ahead):
        for way in (1, -1):
            joints(site, road, way, 4.6)
    for way in (1, -1):
        build_along(site, main, way, HOUSES, 0.0, ahead.paved[1])
        build_along(site, side, way, HOUSES, 20.0, side.paved[1])
        joints(site, side, way, 4.6)
    close_view(site, side, side.paved[1], 1, HOUSES)
    close_view(site, ahead, ahead.paved[1], 1, HOUSES)
    close_view(site, main, main.paved[0], -1, HOUSES)
    _furnish(site, main, ahead, side)
    woods(site, 0.5, 16.0)
    return site


def _layout(rng: Generator, length: float) -> Layout:
    total = EGO_START + length + RUN_OUT
    line = ReferenceLine.straight(Pose(-EGO_START, 0.0, 0.0), total)
    section = Section(2, 2, lane_width=float(rng.uniform(3.25, 3.4)), edge=0.35)
    crossing = EGO_START + length * float(rng.uniform(0.55, 0.75)) + 12.0
    way = int(rng.choice([-1, 1]))
    roads = tee(line, section, Section(1, 1, lane_width=3.3), crossing, way, SPEED, fillet=7.0)
    return Layout(roads.network, roads.route(2), SPEED - 1.5, EDGE)


def _furnish(site: Site, main: Road, ahead: Road, side: Road) -> None:
    rng = site.rng
    sign(site, main, main.end - 1.0, -1, "warning")
    sign(site, side, side.start + 1.0, 1, "yield")
    sign(site, main, 95.0, -1, "speed", speed=50)
    sign(site, ahead, ahead.start + 20.0, -1, "parking")
    lamps(site, main, (1, -1), 34.0, 8.5, 2.2)
    lamps(site, ahead, (1, -1), 34.0, 8.5, 2.2)
    crowns = trees(rng, (5.0, 6.0), ("round",), 4) + trees(rng, (7.0, 8.5), ("tall",), 2)
    small = [
        *several(rng, scenery.litter_bin, 1), *several(rng, scenery.hydrant, 1),
        *several(rng, scenery.parking_meter, 1), *several(rng, scenery.bollard, 1),
    ]  # fmt: skip
    benches = several(rng, scenery.bench, 2)
    for road in (main, ahead):
        for way in (1, -1):
            site.row(road, way, crowns, 16.0, 1.6, jitter=0.9, turn=None, chance=0.85, overlap=0.35)
            site.row(road, way, small, 14.0, 0.6, jitter=4.0, chance=0.8)
            site.row(road, way, benches, 45.0, 2.6, jitter=8.0)
