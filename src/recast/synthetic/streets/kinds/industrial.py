"""A road through an industrial estate: sheds, yards with containers, fences, lorries."""

from __future__ import annotations

from functools import partial

import numpy as np
from numpy.random import Generator

from recast.synthetic import scenery
from recast.synthetic.streets.dress import (
    Frontage,
    build_along,
    close_view,
    driveway,
    lamps,
    line_along,
    several,
    sign,
    trees,
    woods,
)  # fmt: skip
from recast.synthetic.streets.ground import GRASS, PAVING, Band, Edge
from recast.synthetic.streets.junctions import tee
from recast.synthetic.streets.network import Arm
from recast.synthetic.streets.paint import RoadPaint, bays, paint_arm, paint_road, park_along
from recast.synthetic.streets.reference_line import Pose, ReferenceLine
from recast.synthetic.streets.road import Road, Section
from recast.synthetic.streets.site import EGO_START, RUN_OUT, Layout, Site
from recast.synthetic.streets.wear import Wear

EDGE = Edge(
    kerb=True,
    bands=(Band(1.8, PAVING, "concrete"), Band(1.6, GRASS, "grass")),
    land=((0.215, 0.21, 0.195), "concrete"),
)
SHEDS = Frontage("industrial", (15.0, 24.0), (26.0, 48.0), (22.0, 36.0), (14.0, 24.0))
SPEED = 13.9


def industrial(rng: Generator, length: float) -> Site:
    """Build the street."""
    layout_rng, site_rng = rng.spawn(2)
    site = Site(_layout(layout_rng, length), site_rng)
    main, ahead, side = site.road("main"), site.road("ahead"), site.road("side")
    for road, ends in ((main, (False, True)), (ahead, (True, False))):
        paint_road(site, road, RoadPaint("dashed", solid=18.0), ends)
        places = bays(road.start + 6.0, road.end - 8.0, 11.0, 2)[0]
        park_along(site, road, -1, places, 0.4, 11.0, 9.5, ticks=False)
    paint_road(site, side, RoadPaint("solid"), (True, False))
    paint_arm(site, Arm(side, False), "stop", zebra=False)
    sign(site, side, side.start + 0.5, 1, "stop")
    sign(site, main, EGO_START + 18.0, -1, "speed", speed=50)
    sign(site, main, main.end - 28.0, -1, "direction", away=2.4)
    close_view(site, ahead, ahead.paved[1], 1, SHEDS)
    close_view(site, main, 0.0, -1, SHEDS)
    for way in (1, -1):
        _yards(site, main, way, 0.0, ahead.paved[1])
        _yards(site, side, way, 30.0, side.paved[1])
    for road in (main, ahead):
        lamps(site, road, (1,), 38.0, 9.0, 2.0)
    _clutter(site, main, ahead)
    woods(site, 0.9, 12.0)
    return site


def _layout(rng: Generator, length: float) -> Layout:
    total = EGO_START + length + RUN_OUT
    line = ReferenceLine.straight(Pose(-EGO_START, 0.0, 0.0), total)
    section = Section(1, 1, lane_width=3.7, parking_right=2.9, edge=0.4)
    crossing = EGO_START + length * float(rng.uniform(0.55, 0.75)) + 16.0
    way = int(rng.choice([-1, 1]))
    minor = Section(1, 1, lane_width=3.7, edge=0.4)
    roads = tee(line, section, minor, crossing, way, SPEED, 11.0, zebra=False)
    wear = Wear((0.128, 0.127, 0.125), patches=7.0, cracks=15.0, covers=2.0, tracks=1.5)
    return Layout(roads.network, roads.route(1), SPEED - 2.0, EDGE, 11.0, wear=wear)


def _yards(site: Site, road: Road, side: int, start: float, end: float) -> None:
    """Sheds with a gate beside each, and a fence in front."""
    rng = site.rng
    last = start
    for _, shed_end in build_along(site, road, side, SHEDS, start, end):
        gate = shed_end + 6.0
        driveway(site, road, gate, side, 8.0, EDGE.width + 0.5, (0.2, 0.195, 0.185))
        fence = partial(scenery.fence, rng, style=str(rng.choice(["mesh", "iron", "mesh"])))
        line_along(site, road, side, EDGE.width + 0.4, fence, last, gate - 4.3)
        last = gate + 4.3
    fence = partial(scenery.fence, rng, style="mesh")
    line_along(site, road, side, EDGE.width + 0.4, fence, last, end - 3.0)


def _clutter(site: Site, main: Road, ahead: Road) -> None:
    rng = site.rng
    boxes = [
        *several(rng, scenery.container, 3), *several(rng, lambda r: scenery.container(r, 12.19), 2)
    ]  # fmt: skip
    goods = several(rng, scenery.pallets, 4)
    boards = several(rng, scenery.hoarding, 1)
    crowns = trees(rng, (6.0, 9.0), ("round", "tall"), 3)
    for road in (main, ahead):
        for way in (1, -1):
            site.row(road, way, boxes, 15.0, 9.0, jitter=4.0, chance=0.75, off_pavement=True)
            site.row(road, way, boxes, 21.0, 9.5, jitter=5.0, turn=np.pi / 2, chance=0.5,
                     off_pavement=True)  # fmt: skip
            site.row(road, way, goods, 8.0, 5.6, jitter=2.5, turn=None, chance=0.5,
                     off_pavement=True)  # fmt: skip
            site.row(road, way, crowns, 48.0, 2.6, jitter=8.0, turn=None, chance=0.6)
            site.row(road, way, boards, 130.0, 4.6, jitter=25.0, off_pavement=True)
            site.row(road, way, several(rng, scenery.hydrant, 1), 70.0, 0.6, jitter=9.0)
