"""A residential street that winds between houses with front gardens."""

from __future__ import annotations

from functools import partial

import numpy as np
from numpy.random import Generator

from recast.synthetic import scenery
from recast.synthetic.streets.dress import (
    Frontage,
    build_along,
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
from recast.synthetic.surface import Surface

EDGE = Edge(
    kerb=True,
    bands=(Band(1.5, GRASS, "grass"), Band(1.7, PAVING, "concrete")),
    land=(GRASS, "grass"),
    hills=20.0,
)
HOUSES = Frontage("suburban", (8.5, 11.0), (9.5, 14.0), (8.0, 11.0), (6.0, 9.0))
SPEED = 11.1


def suburban_curve(rng: Generator, length: float) -> Site:
    """Build the street."""
    layout_rng, site_rng = rng.spawn(2)
    site = Site(_layout(layout_rng, length), site_rng)
    main, ahead, side = site.road("main"), site.road("ahead"), site.road("side")
    paint = RoadPaint("dashed", edges=False, solid=14.0)
    paint_road(site, main, paint, (False, True))
    paint_road(site, ahead, paint, (True, False))
    paint_road(site, side, RoadPaint("none", edges=False), (True, False))
    paint_arm(site, Arm(side, False), "stop", zebra=False)
    sign(site, side, side.start + 0.5, 1, "stop")
    sign(site, main, EGO_START + 16.0, -1, "speed", speed=40)
    sign(site, main, main.end - 30.0, -1, "warning")
    for road, end in ((main, ahead.paved[1]), (side, side.paved[1])):
        for way in (1, -1):
            _plots(site, road, way, 22.0 if road is side else 0.0, end)
    for road in (main, ahead):
        for way in (1, -1):
            park_along(
                site, road, way, bays(road.start + 4, road.end - 6, 9.0, 3)[0], 0.35, ticks=False
            )
        lamps(site, road, (1 if main.line.length % 2 < 1 else -1,), 36.0, 6.5, 1.4)
        _trees(site, road)
    woods(site, 0.9, 13.0)
    return site


def _layout(rng: Generator, length: float) -> Layout:
    total = EGO_START + length + RUN_OUT
    way = float(rng.choice([-1.0, 1.0]))
    first, second = way / rng.uniform(70, 110), -way / rng.uniform(80, 130)
    arc = float(np.clip(0.42 * length, 30.0, 90.0))
    line = ReferenceLine.from_bends(
        Pose(-EGO_START, 0.0, 0.0),
        [
            (EGO_START + 0.06 * length, 0.0), (arc, first), (0.16 * length + 18.0, 0.0),
            (arc, second), (total, 0.0),
        ],
        transition=26.0,
    ).part(0.0, total)  # fmt: skip
    section = Section(1, 1, lane_width=3.3, parking_right=2.2, parking_left=2.2, edge=0.15)
    crossing = EGO_START + 0.06 * length + arc + 0.08 * length + 9.0
    roads = tee(
        line, section, Section(1, 1, lane_width=3.3), crossing, -int(way), SPEED, 6.0, zebra=False
    )
    wear = Wear((0.135, 0.133, 0.13), patches=5.0, cracks=12.0, covers=2.0, tracks=0.7)
    return Layout(roads.network, roads.route(1), SPEED - 1.1, EDGE, 6.0, wear=wear)


def _plots(site: Site, road: Road, side: int, start: float, end: float) -> None:
    """Houses, each with a driveway, and hedges or fences along the pavement."""
    rng = site.rng
    last = start
    for _, house_end in build_along(site, road, side, HOUSES, start, end):
        drive = house_end + 2.4
        driveway(site, road, drive, side, 3.0, 13.0, (0.24, 0.23, 0.215))
        kind = str(rng.choice(_FENCES, p=[0.4, 0.2, 0.1, 0.1, 0.2]))
        make = partial(_boundary, site.rng, kind, float(rng.uniform(0.8, 1.4)))
        if kind != "open":
            away = EDGE.width + 0.6
            line_along(site, road, side, away, make, last, drive - 1.8, piece=5.0)
        last = drive + 2.0


_FENCES = ("hedge", "picket", "wood", "wall", "open")


def _boundary(rng: Generator, kind: str, height: float, length: float) -> Surface:
    if kind == "hedge":
        return scenery.hedge(rng, length, height)
    if kind == "wall":
        return scenery.wall(rng, length, 0.8, "stone")
    return scenery.fence(rng, length, kind)


def _trees(site: Site, road: Road) -> None:
    rng = site.rng
    crowns = trees(rng, (6.0, 9.0), ("round", "conifer", "round", "tall"), 6)
    bushes = several(rng, lambda r: scenery.bush(r, float(r.uniform(0.7, 1.3))), 4)
    for way in (1, -1):
        site.row(road, way, crowns[:1] + crowns[2:3], 19.0, 0.8, jitter=1.5, turn=None, chance=0.5)
        site.row(road, way, crowns, 13.0, 6.6, jitter=3.0, turn=None, chance=0.45,
                 off_pavement=True)  # fmt: skip
        site.row(road, way, crowns, 15.0, 24.0, jitter=6.0, turn=None, chance=0.7)
        site.row(road, way, bushes, 8.0, 7.4, jitter=2.0, turn=None, chance=0.5)
        site.row(road, way, several(rng, scenery.hydrant, 1), 80.0, 0.6, jitter=10.0)
