"""A narrow town street with cars parked along both kerbs, and trees between them."""

from __future__ import annotations

import numpy as np
import shapely
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
from recast.synthetic.streets.ground import PAVING, Band, Edge, Island
from recast.synthetic.streets.junctions import tee
from recast.synthetic.streets.network import Arm
from recast.synthetic.streets.paint import RoadPaint, bays, paint_arm, paint_road, park_along
from recast.synthetic.streets.reference_line import Pose, ReferenceLine
from recast.synthetic.streets.road import Road, Section
from recast.synthetic.streets.site import EGO_START, RUN_OUT, Layout, Site
from recast.synthetic.streets.wear import Wear

EDGE = Edge(
    kerb=True, bands=(Band(3.0, PAVING, "concrete"),), land=((0.25, 0.24, 0.22), "concrete")
)
HOUSES = Frontage("urban", (3.2, 3.4), (7.5, 13.0), (9.0, 12.0), (0.0, 0.0), (2, 4))
SPEED = 8.3
PITCH, BLOCK = 6.0, 4


def parked_street(rng: Generator, length: float) -> Site:
    """Build the street."""
    layout_rng, site_rng = rng.spawn(2)
    site = Site(_layout(layout_rng, length), site_rng)
    main, ahead, side = site.road("main"), site.road("ahead"), site.road("side")
    for road, ends in ((main, (False, True)), (ahead, (True, False))):
        paint_road(site, road, RoadPaint("dashed", edges=False, solid=10.0, dash=2, gap=4), ends)
        for way in (1, -1):
            park_along(site, road, way, _places(road)[0], 0.92, PITCH)
            joints(site, road, way, 3.0)
    paint_road(site, side, RoadPaint("none", edges=False), (True, False))
    paint_arm(site, Arm(side, False), "yield", zebra=False)
    paint_arm(site, Arm(main, True), "none", zebra=True)
    sign(site, side, side.start + 0.5, 1, "yield")
    sign(site, main, EGO_START + 14.0, -1, "parking")
    sign(site, ahead, ahead.start + 12.0, -1, "parking")
    sign(site, main, EGO_START - 12.0, -1, "speed", speed=30)
    for way in (1, -1):
        build_along(site, main, way, HOUSES, 0.0, ahead.paved[1])
        build_along(site, side, way, HOUSES, 18.0, side.paved[1])
        joints(site, side, way, 3.0)
    close_view(site, side, side.paved[1], 1, HOUSES)
    close_view(site, ahead, ahead.paved[1], 1, HOUSES)
    close_view(site, main, 0.0, -1, HOUSES)
    _furnish(site, main, ahead)
    woods(site, 0.5, 14.0)
    return site


def _layout(rng: Generator, length: float) -> Layout:
    total = EGO_START + length + RUN_OUT
    bend = float(rng.choice([-1.0, 1.0])) / rng.uniform(350, 600)
    line = ReferenceLine.from_bends(
        Pose(-EGO_START, 0.0, 0.0), [(EGO_START + 0.4 * length, 0.0), (total, bend)], 60.0
    ).part(0.0, total)
    section = Section(1, 1, lane_width=3.25, parking_right=2.2, parking_left=2.2, edge=0.1)
    crossing = EGO_START + length * float(rng.uniform(0.6, 0.75)) + 14.0
    way = int(rng.choice([-1, 1]))
    roads = tee(line, section, Section(1, 1, lane_width=3.2), crossing, way, SPEED, 5.0)
    islands = []
    for road in (roads.main, roads.ahead):
        for side in (1, -1):
            islands += [_build_out(road, s, side) for s in _places(road)[1]]
    wear = Wear((0.12, 0.118, 0.115), patches=6.0, cracks=12.0, covers=3.5, tracks=0.6)
    return Layout(roads.network, roads.route(1), SPEED - 0.3, EDGE, 5.0, tuple(islands), wear)


def _places(road: Road) -> tuple[list[float], list[float]]:
    """Parking places, and those that a tree takes instead."""
    return bays(road.start + 2.0, road.end - 4.0, PITCH, BLOCK)


def _build_out(road: Road, s: float, side: int) -> Island:
    section = road.section
    inner, outer = section.lanes_edge(side) + side * 0.5, section.kerb(side) + side * 0.05
    half = PITCH / 2 - 0.4
    corners = road.point(
        np.array([s - half, s - half + 0.8, s + half - 0.8, s + half]),
        np.array([outer, inner, inner, outer]),
    )
    return Island(shapely.Polygon(corners), PAVING, "concrete")


def _furnish(site: Site, main: Road, ahead: Road) -> None:
    rng = site.rng
    # Only narrow crowns fit between a lane and the houses.
    crowns = trees(rng, (5.5, 8.5), ("tall",), 6)
    small = [
        *several(rng, scenery.litter_bin, 1), *several(rng, scenery.parking_meter, 2),
        *several(rng, scenery.bollard, 1), *several(rng, scenery.bench, 1),
    ]  # fmt: skip
    for road in (main, ahead):
        lamps(site, road, (1, -1), 30.0, 6.5, 1.2)
        for way in (1, -1):
            for s in _places(road)[1]:
                crown = crowns[int(rng.integers(len(crowns)))]
                spot = site.beside(road, s, way, -0.45)
                turned = Pose(spot.x, spot.y, float(rng.uniform(0, 2 * np.pi)))
                site.placer.place(crown, turned, overlap=0.5)
            site.row(road, way, small, 11.0, 0.5, jitter=3.0, chance=0.8)
