"""A four-lane road that passes beneath two bridges."""

from __future__ import annotations

import numpy as np
import shapely
from numpy.random import Generator

from recast.geometry import se3
from recast.synthetic import scenery
from recast.synthetic.streets.dress import (
    Frontage,
    build_along,
    lamps,
    line_along,
    several,
    sign,
    trees,
    woods,
)  # fmt: skip
from recast.synthetic.streets.ground import GRASS, PAVING, Band, Edge
from recast.synthetic.streets.network import Network
from recast.synthetic.streets.paint import RoadPaint, paint_road
from recast.synthetic.streets.reference_line import Pose, ReferenceLine
from recast.synthetic.streets.road import Road, Section
from recast.synthetic.streets.site import EGO_START, RUN_OUT, Layout, Site

EDGE = Edge(
    kerb=True,
    bands=(Band(2.6, PAVING, "concrete"), Band(1.2, GRASS, "grass")),
    land=(GRASS, "grass"),
)
OFFICES = Frontage("office", (16.0, 24.0), (20.0, 40.0), (14.0, 20.0), (10.0, 26.0))
SHEDS = Frontage("industrial", (14.0, 22.0), (24.0, 40.0), (18.0, 26.0), (10.0, 22.0))
SPEED = 13.9
CLEARANCE = 5.0
_SLOPE = 1.6


def underpass(rng: Generator, length: float) -> Site:
    """Build the street."""
    layout_rng, site_rng = rng.spawn(2)
    site = Site(_layout(layout_rng, length), site_rng)
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
    for way, frontage in ((1, OFFICES), (-1, SHEDS)):
        build_along(site, main, way, frontage, 0.0, main.end)
        for start, end in ((first - 46.0, first - wide / 2 - 9.0), (second + 13.0, second + 45.0)):
            line_along(
                site, main, way, EDGE.width + 0.5,
                lambda n: scenery.wall(site.rng, n, 2.6, "concrete"), start, end,
            )  # fmt: skip
    lamps(site, main, (1, -1), 36.0, 9.0, 2.2)
    _plant(site, main)
    woods(site, 0.8, 13.0)
    return site


def _layout(rng: Generator, length: float) -> Layout:
    total = EGO_START + length + RUN_OUT
    bend = float(rng.uniform(-1.0, 1.0)) / 500
    line = ReferenceLine.from_bends(
        Pose(-EGO_START, 0.0, 0.0), [(EGO_START + 0.8 * length + 60, 0.0), (total, bend)], 60.0
    ).part(0.0, total)
    section = Section(2, 2, lane_width=3.5, edge=0.5)
    main = Road("main", line, section, 0.0, total, SPEED, (0.0, total))
    network = Network([main])
    route = network.route(main.lane_id(0, 2), main.lane_id(len(main.blocks()) - 2, 2))
    return Layout(network, route, SPEED - 1.0, EDGE)


def _bridge(site: Site, road: Road, s: float, width: float) -> None:
    """A bridge across the road; the ground beneath and its ramps are taken."""
    span = 2 * (abs(road.section.kerb(1)) + EDGE.width)
    middle = road.line.pose(s)
    made = scenery.bridge(site.rng, span, width, CLEARANCE)
    world_from_bridge = se3.from_rotation_translation(
        se3.rotation_z(middle.heading), np.array([middle.x, middle.y, 0.0])
    )
    site.extras.append(made.transformed(world_from_bridge))
    reach = width / 2 + _SLOPE * (CLEARANCE + 1.5)
    corners = [(s - reach, 1), (s + reach, 1), (s + reach, -1), (s - reach, -1)]
    for near in (1, -1):
        outline = [road.point(a, near * (span / 2 + (0.0 if b > 0 else 58.0))) for a, b in corners]
        site.placer.reserve(shapely.Polygon(outline))
    under = [road.point(s + a * (width / 2 + 1), b * span / 2) for a, b in
             ((-1, -1), (1, -1), (1, 1), (-1, 1))]  # fmt: skip
    site.placer.reserve(shapely.Polygon(under))


def _plant(site: Site, road: Road) -> None:
    rng = site.rng
    crowns = trees(rng, (6.5, 9.5), ("round", "tall", "conifer"), 5)
    bushes = several(rng, lambda r: scenery.bush(r, float(r.uniform(0.7, 1.4))), 4)
    for way in (1, -1):
        site.row(road, way, crowns, 16.0, 6.5, jitter=3.0, turn=None, chance=0.7)
        site.row(road, way, crowns, 24.0, 14.0, jitter=7.0, turn=None, chance=0.5)
        site.row(road, way, bushes, 8.0, 5.2, jitter=2.5, turn=None, chance=0.6)
        site.row(road, way, several(rng, scenery.hoarding, 1), 130.0, 6.0, jitter=25.0)
