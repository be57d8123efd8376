"""A crossing of two wide streets with traffic lights, at which the ego turns."""

from __future__ import annotations

import numpy as np
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
from recast.synthetic.streets.network import Arm, Network
from recast.synthetic.streets.paint import RoadPaint, paint_arm, paint_road
from recast.synthetic.streets.placement import Prop
from recast.synthetic.streets.reference_line import Pose, ReferenceLine
from recast.synthetic.streets.road import Road, Section
from recast.synthetic.streets.site import EGO_START, RUN_OUT, Layout, Site

EDGE = Edge(
    kerb=True, bands=(Band(4.6, PAVING, "concrete"),), land=((0.25, 0.24, 0.22), "concrete")
)
HOUSES = Frontage("urban", (4.8, 5.0), (11.0, 22.0), (11.0, 15.0), (0.0, 0.0), (3, 7))
OFFICES = Frontage("office", (5.2, 6.5), (22.0, 34.0), (15.0, 20.0), (1.0, 6.0))
SPEED = 13.9
FILLET = 8.0


def signalled_intersection(rng: Generator, length: float) -> Site:
    """Build the street."""
    layout_rng, site_rng = rng.spawn(2)
    site = Site(_layout(layout_rng, length), site_rng)
    roads = [site.road(name) for name in ("main", "ahead", "left", "right")]
    for road in roads:
        ends = (False, True) if road.name == "main" else (True, False)
        paint_road(site, road, RoadPaint("double", edges=False, solid=30.0), ends)
        arm = Arm(road, road.name == "main")
        paint_arm(site, arm, "stop", zebra=True, arrows=("straight-left", "straight-right"))
        _signals(site, arm, "green" if road.name in ("main", "ahead") else "red")
    for road in roads:
        first = HOUSES if site.rng.random() < 0.6 else OFFICES
        for way in (1, -1):
            begin = road.paved[0] + (0.0 if road.name == "main" else 24.0)
            end = road.paved[1] - (24.0 if road.name == "main" else 0.0)
            build_along(site, road, way, first, begin, end)
            joints(site, road, way, 4.6)
        far = (road.paved[0], -1) if road.name == "main" else (road.paved[1], 1)
        close_view(site, road, *far, HOUSES)
        _furnish(site, road)
    woods(site, 0.4, 16.0)
    return site


def _layout(rng: Generator, length: float) -> Layout:
    turn = str(rng.choice(["left", "right"]))
    section = Section(2, 2, lane_width=3.4, edge=0.35)
    half = section.kerb(1) + FILLET + 5.0
    crossing = EGO_START + max(26.0, 0.3 * length) + half
    rest = length + EGO_START + RUN_OUT - crossing + half
    line = ReferenceLine.straight(Pose(-EGO_START, 0.0, 0.0), crossing + 150.0)
    centre = line.pose(crossing)
    main = Road("main", line, section, 0.0, crossing - half, SPEED, (0.0, crossing))
    ahead = Road(
        "ahead", line, section, crossing + half, line.length, SPEED, (crossing, line.length)
    )
    arms = [Arm(main, True), Arm(ahead, False)]
    for name, way in (("left", 1), ("right", -1)):
        reach = rest if name == turn else 130.0
        cross = ReferenceLine.straight(centre._replace(heading=way * np.pi / 2), reach)
        road = Road(name, cross, section, half, reach, SPEED, (0.0, reach))
        arms.append(Arm(road, False))
    network = Network([arm.road for arm in arms])
    network.junction("crossing", arms, right_reach=FILLET + 3.5)
    exit_road = network.roads[turn]
    index = 1 if turn == "left" else 2
    route = network.route(
        main.lane_id(0, index), exit_road.lane_id(len(exit_road.blocks()) - 2, index)
    )
    return Layout(network, route, 11.0, EDGE, FILLET)


def _signals(site: Site, arm: Arm, state: str) -> None:
    """A signal with a mast arm beside the stop line, and one across the junction."""
    road, towards = arm.road, 1 if arm.at_end else -1
    s = road.end if arm.at_end else road.start
    heading = float(road.line.heading(s)) + (0.0 if towards > 0 else np.pi)
    mast = Prop.of(scenery.traffic_signal(site.rng, state, 5.2))
    post = Prop.of(scenery.traffic_signal(site.rng, state))
    for prop, side, shift in ((mast, -towards, 0.4), (post, towards, 0.4)):
        for away in (0.6, 0.9, 1.2):
            spot = site.beside(road, s + towards * shift, side, away)
            if site.placer.place(prop, Pose(spot.x, spot.y, heading)):
                break


def _furnish(site: Site, road: Road) -> None:
    rng = site.rng
    lamps(site, road, (1, -1), 34.0, 8.5, 2.2)
    crowns = trees(rng, (5.0, 6.0), ("round",), 2) + trees(rng, (7.0, 8.5), ("tall",), 1)
    small = [
        *several(rng, scenery.litter_bin, 1), *several(rng, scenery.hydrant, 1),
        *several(rng, scenery.bollard, 1), *several(rng, scenery.bench, 1),
    ]  # fmt: skip
    sign(site, road, (road.start + road.end) / 2, -1, "speed", speed=50)
    for way in (1, -1):
        start, end = road.start + 8, road.end - 8
        site.row(road, way, crowns, 17.0, 1.6, start, end, 0.9, None, overlap=0.35, chance=0.75)
        site.row(road, way, small, 16.0, 0.6, jitter=4.0, chance=0.8)
