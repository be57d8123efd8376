"""Streets of the outskirts: a wide arterial road, an underpass, and an industrial estate."""

from __future__ import annotations

from functools import partial

import numpy as np
import shapely
from numpy.random import Generator

from recast.synthetic import scenery
from recast.synthetic.scenery.primitives import at
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
)
from recast.synthetic.streets.ground import GRASS, PAVING, Band, Edge, Island
from recast.synthetic.streets.markings import (
    RoadPaint,
    bays,
    paint_arm,
    paint_road,
    paint_through,
    park_along,
)
from recast.synthetic.streets.network import JunctionArm, StreetNetwork, tee
from recast.synthetic.streets.road import Road, Section, Wear
from recast.synthetic.streets.shapes import Pose, ReferenceLine
from recast.synthetic.streets.site import EGO_START, RUN_OUT, Site, StreetLayout

ARTERIAL_EDGE = Edge(True, (Band(2.4, GRASS), Band(2.6, PAVING)), GRASS)
ARTERIAL_OFFICES = Frontage("office", (12.0, 18.0), (24.0, 46.0), (15.0, 24.0), (8.0, 22.0))
ARTERIAL_SPEED = 16.7
UNDERPASS_EDGE = Edge(True, (Band(2.6, PAVING), Band(1.2, GRASS)), GRASS)
UNDERPASS_OFFICES = Frontage("office", (16.0, 24.0), (20.0, 40.0), (14.0, 20.0), (10.0, 26.0))
UNDERPASS_SHEDS = Frontage("industrial", (14.0, 22.0), (24.0, 40.0), (18.0, 26.0), (10.0, 22.0))
UNDERPASS_SPEED = 13.9
CLEARANCE = 5.0
_SLOPE = 1.6
ESTATE_LAND = ((0.215, 0.21, 0.195), "concrete")
ESTATE_EDGE = Edge(True, (Band(1.8, PAVING), Band(1.6, GRASS)), ESTATE_LAND)
ESTATE_SHEDS = Frontage("industrial", (15.0, 24.0), (26.0, 48.0), (22.0, 36.0), (14.0, 24.0))
ESTATE_SPEED = 13.9


def arterial_median(rng: Generator, length: float) -> Site:
    """Build the street."""
    layout_rng, site_rng = rng.spawn(2)
    site = Site(_arterial_layout(layout_rng, length), site_rng)
    main, ahead, side = site.road("main"), site.road("ahead"), site.road("side")
    paint_road(site, main, RoadPaint(solid=0.0), (False, True))
    paint_road(site, ahead, RoadPaint(solid=0.0), (True, False))
    paint_through(site, main, ahead)
    paint_road(site, side, RoadPaint("solid", solid=12), (True, False))
    paint_arm(site, JunctionArm(side, False), "yield", zebra=False)
    for way in (1, -1):
        build_along(site, main, way, ARTERIAL_OFFICES, main.paved[0], ahead.paved[1])
    _furnish_arterial(site, main, ahead)
    _plant_median(site, main, ahead)
    woods(site, 0.7, 14.0)
    return site


def _arterial_layout(rng: Generator, length: float) -> StreetLayout:
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
        line,
        section,
        Section(1, 1, lane_width=3.3, edge=0.4),
        crossing,
        way=-1,
        speed=ARTERIAL_SPEED,
        fillet=9.0,
        zebra=False,
        barred=[("ahead", "side"), ("side", "main")],
    )
    main = roads.main
    s = main.stations(6.0, total - 6.0)
    half_median = section.median / 2 - 0.35
    rim = np.concatenate([main.point(s, -half_median), main.point(s, half_median)[::-1]])
    median = shapely.Polygon(rim).buffer(-0.3).buffer(0.3)
    islands = (Island(median, GRASS),)
    return StreetLayout(
        roads.network, roads.route(2), ARTERIAL_SPEED - 2.5, ARTERIAL_EDGE, 9.0, islands
    )


def _furnish_arterial(site: Site, main: Road, ahead: Road) -> None:
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
            site.row(road, way, crowns, 22.0, 6.8, jitter=4.0, turn=None, share=0.7)
            site.row(road, way, boards, 110.0, 7.0, jitter=20.0)
            site.row(road, way, small, 60.0, 4.4, jitter=15.0)
            site.row(road, way, bushes, 17.0, 9.0, jitter=8.0, turn=None, share=0.6)


def _plant_median(site: Site, main: Road, ahead: Road) -> None:
    rng = site.rng
    crowns = trees(rng, (6.0, 7.5), ("tall", "round"), 4, detail=0.8)
    hedge = several(rng, lambda r: scenery.bush(r, 0.9), 3)
    inside = -main.section.kerb(1)
    for way_road in (main, ahead):
        site.row(way_road, 1, crowns, 20.0, inside, jitter=1.0, turn=None, share=0.9)
        site.row(way_road, 1, hedge, 9.0, inside, jitter=1.5, turn=None, share=0.7)


def underpass(rng: Generator, length: float) -> Site:
    """Build the street."""
    layout_rng, site_rng = rng.spawn(2)
    site = Site(_underpass_layout(layout_rng, length), site_rng)
    main = site.road("main")
    paint_road(site, main, RoadPaint("double"), (False, False))
    wide = float(site.rng.uniform(11.0, 16.0))
    first = EGO_START + 0.42 * length + 16.0
    second = first + wide / 2 + 42.0
    for s, width in ((first, wide), (second, 7.0)):
        _bridge(site, main, s, width)
    sign(site, main, EGO_START + 16.0, -1, "speed", speed=50)
    sign(site, main, first - 28.0, -1, "warning")
    sign(site, main, second + 40.0, -1, "direction", away=2.9)
    for way, frontage in ((1, UNDERPASS_OFFICES), (-1, UNDERPASS_SHEDS)):
        build_along(site, main, way, frontage, 0.0, main.end)
        walls = partial(scenery.wall, site.rng, height=2.6, style="concrete")
        away = UNDERPASS_EDGE.width + 0.5
        line_along(site, main, way, away, walls, first - 46.0, first - wide / 2 - 9.0)
        line_along(site, main, way, away, walls, second + 13.0, second + 45.0)
    lamps(site, main, (1, -1), 36.0, 9.0, 2.2)
    _plant_underpass(site, main)
    woods(site, 0.8, 13.0)
    return site


def _underpass_layout(rng: Generator, length: float) -> StreetLayout:
    total = EGO_START + length + RUN_OUT
    bend = float(rng.uniform(-1.0, 1.0)) / 500
    line = ReferenceLine.from_bends(
        Pose(-EGO_START, 0.0, 0.0), [(EGO_START + 0.8 * length + 60, 0.0), (total, bend)], 60.0
    ).part(0.0, total)
    section = Section(2, 2, lane_width=3.5, edge=0.5)
    main = Road("main", line, section, 0.0, total, UNDERPASS_SPEED, (0.0, total))
    network = StreetNetwork([main])
    route = network.route(main.lane_id(0, 2), main.lane_id(len(main.blocks()) - 2, 2))
    return StreetLayout(network, route, UNDERPASS_SPEED - 1.0, UNDERPASS_EDGE)


def _bridge(site: Site, road: Road, s: float, width: float) -> None:
    """A bridge across the road; the ground beneath and its ramps are taken."""
    span = 2 * (abs(road.section.kerb(1)) + UNDERPASS_EDGE.width)
    middle = road.line.pose(s)
    made = scenery.bridge(site.rng, span, width, CLEARANCE)
    site.extras.append(at(made, middle.x, middle.y, 0.0, middle.heading))
    reach = width / 2 + _SLOPE * (CLEARANCE + 1.5)
    corners = [(s - reach, 1), (s + reach, 1), (s + reach, -1), (s - reach, -1)]
    for near in (1, -1):
        outline = [road.point(a, near * (span / 2 + (0.0 if b > 0 else 58.0))) for a, b in corners]
        site.placer.reserve(shapely.Polygon(outline))
    under = [
        road.point(s + a * (width / 2 + 1), b * span / 2)
        for a, b in ((-1, -1), (1, -1), (1, 1), (-1, 1))
    ]
    site.placer.reserve(shapely.Polygon(under))


def _plant_underpass(site: Site, road: Road) -> None:
    rng = site.rng
    crowns = trees(rng, (6.5, 9.5), ("round", "tall", "conifer"), 5)
    bushes = several(rng, lambda r: scenery.bush(r, float(r.uniform(0.7, 1.4))), 4)
    for way in (1, -1):
        site.row(road, way, crowns, 16.0, 6.5, jitter=3.0, turn=None, share=0.7)
        site.row(road, way, crowns, 24.0, 14.0, jitter=7.0, turn=None, share=0.5)
        site.row(road, way, bushes, 8.0, 5.2, jitter=2.5, turn=None, share=0.6)
        site.row(road, way, several(rng, scenery.hoarding, 1), 130.0, 6.0, jitter=25.0)


def industrial(rng: Generator, length: float) -> Site:
    """Build the street."""
    layout_rng, site_rng = rng.spawn(2)
    site = Site(_estate_layout(layout_rng, length), site_rng)
    main, ahead, side = site.road("main"), site.road("ahead"), site.road("side")
    for road, ends in ((main, (False, True)), (ahead, (True, False))):
        paint_road(site, road, RoadPaint("dashed", solid=18.0), ends)
        places = bays(road.start + 6.0, road.end - 8.0, 11.0, 2)[0]
        park_along(site, road, -1, places, 0.4, 11.0, 9.5, ticks=False)
    paint_road(site, side, RoadPaint("solid"), (True, False))
    paint_arm(site, JunctionArm(side, False), "stop", zebra=False)
    sign(site, side, side.start + 0.5, 1, "stop")
    sign(site, main, EGO_START + 18.0, -1, "speed", speed=50)
    sign(site, main, main.end - 28.0, -1, "direction", away=2.4)
    close_view(site, ahead, ahead.paved[1], 1, ESTATE_SHEDS)
    close_view(site, main, 0.0, -1, ESTATE_SHEDS)
    for way in (1, -1):
        _yards(site, main, way, 0.0, ahead.paved[1])
        _yards(site, side, way, 30.0, side.paved[1])
    for road in (main, ahead):
        lamps(site, road, (1,), 38.0, 9.0, 2.0)
    _clutter(site, main, ahead)
    woods(site, 0.9, 12.0)
    return site


def _estate_layout(rng: Generator, length: float) -> StreetLayout:
    total = EGO_START + length + RUN_OUT
    line = ReferenceLine.straight(Pose(-EGO_START, 0.0, 0.0), total)
    section = Section(1, 1, lane_width=3.7, parking_right=2.9, edge=0.4)
    crossing = EGO_START + length * float(rng.uniform(0.55, 0.75)) + 16.0
    way = int(rng.choice([-1, 1]))
    minor = Section(1, 1, lane_width=3.7, edge=0.4)
    roads = tee(line, section, minor, crossing, way, ESTATE_SPEED, 11.0, zebra=False)
    wear = Wear((0.128, 0.127, 0.125), patches=7.0, cracks=15.0, covers=2.0, tracks=1.5)
    return StreetLayout(
        roads.network, roads.route(1), ESTATE_SPEED - 2.0, ESTATE_EDGE, 11.0, wear=wear
    )


def _yards(site: Site, road: Road, side: int, start: float, end: float) -> None:
    """Sheds with a gate beside each, and a fence in front."""
    rng = site.rng
    last = start
    for _, shed_end in build_along(site, road, side, ESTATE_SHEDS, start, end):
        gate = shed_end + 6.0
        driveway(site, road, gate, side, 8.0, ESTATE_EDGE.width + 0.5, (0.2, 0.195, 0.185))
        fence = partial(scenery.fence, rng, style=str(rng.choice(["mesh", "iron", "mesh"])))
        line_along(site, road, side, ESTATE_EDGE.width + 0.4, fence, last, gate - 4.3)
        last = gate + 4.3
    fence = partial(scenery.fence, rng, style="mesh")
    line_along(site, road, side, ESTATE_EDGE.width + 0.4, fence, last, end - 3.0)


def _clutter(site: Site, main: Road, ahead: Road) -> None:
    rng = site.rng
    boxes = several(rng, scenery.container, 3)
    boxes += several(rng, lambda r: scenery.container(r, 12.19), 2)
    goods = several(rng, scenery.pallets, 4)
    boards = several(rng, scenery.hoarding, 1)
    crowns = trees(rng, (6.0, 9.0), ("round", "tall"), 3)
    for road in (main, ahead):
        for way in (1, -1):
            row = partial(site.row, road, way)
            yard = partial(row, off_pavement=True)
            yard(boxes, 15.0, 9.0, jitter=4.0, share=0.75)
            yard(boxes, 21.0, 9.5, jitter=5.0, turn=np.pi / 2, share=0.5)
            yard(goods, 8.0, 5.6, jitter=2.5, turn=None, share=0.5)
            row(crowns, 48.0, 2.6, jitter=8.0, turn=None, share=0.6)
            yard(boards, 130.0, 4.6, jitter=25.0)
            row(several(rng, scenery.hydrant, 1), 70.0, 0.6, jitter=9.0)
