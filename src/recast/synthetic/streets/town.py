"""Streets of a town: straight, crossing with lights, and narrow with cars parked along it."""

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
)
from recast.synthetic.streets.ground import PAVING, Band, Edge, Island
from recast.synthetic.streets.markings import RoadPaint, bays, paint_arm, paint_road, park_along
from recast.synthetic.streets.network import JunctionArm, StreetNetwork, tee
from recast.synthetic.streets.road import Road, Section, Wear
from recast.synthetic.streets.shapes import Pose, ReferenceLine
from recast.synthetic.streets.site import EGO_START, RUN_OUT, Prop, Site, StreetLayout

CITY = ((0.25, 0.24, 0.22), "concrete")
TOWN_EDGE = Edge(True, (Band(4.6, PAVING),), CITY)
STRAIGHT_HOUSES = Frontage("urban", (4.8, 5.0), (10.0, 20.0), (10.0, 14.0), (0.0, 0.0), (3, 6))
TOWN_SPEED = 13.9
CROSSING_HOUSES = Frontage("urban", (4.8, 5.0), (11.0, 22.0), (11.0, 15.0), (0.0, 0.0), (3, 7))
CROSSING_OFFICES = Frontage("office", (5.2, 6.5), (22.0, 34.0), (15.0, 20.0), (1.0, 6.0))

FILLET = 8.0
NARROW_EDGE = Edge(True, (Band(3.0, PAVING),), CITY)
NARROW_HOUSES = Frontage("urban", (3.2, 3.4), (7.5, 13.0), (9.0, 12.0), (0.0, 0.0), (2, 4))
NARROW_SPEED = 8.3
PITCH, BLOCK = 6.0, 4


def urban_straight(rng: Generator, length: float) -> Site:
    """Build the street."""
    layout_rng, site_rng = rng.spawn(2)
    site = Site(_straight_layout(layout_rng, length), site_rng)
    main, ahead, side = site.road("main"), site.road("ahead"), site.road("side")
    paint = RoadPaint("double", edges=False)
    paint_road(site, main, paint, (False, True))
    paint_road(site, ahead, paint, (True, False))
    paint_road(site, side, RoadPaint("dashed", edges=False, solid=12), (True, False))
    paint_arm(site, JunctionArm(main, True), "none", zebra=True)
    paint_arm(site, JunctionArm(side, False), "yield", zebra=False)
    for road in (main, ahead):
        for way in (1, -1):
            joints(site, road, way, 4.6)
    for way in (1, -1):
        build_along(site, main, way, STRAIGHT_HOUSES, 0.0, ahead.paved[1])
        build_along(site, side, way, STRAIGHT_HOUSES, 20.0, side.paved[1])
        joints(site, side, way, 4.6)
    close_view(site, side, side.paved[1], 1, STRAIGHT_HOUSES)
    close_view(site, ahead, ahead.paved[1], 1, STRAIGHT_HOUSES)
    close_view(site, main, main.paved[0], -1, STRAIGHT_HOUSES)
    _furnish_straight(site, main, ahead, side)
    woods(site, 0.5, 16.0)
    return site


def _straight_layout(rng: Generator, length: float) -> StreetLayout:
    total = EGO_START + length + RUN_OUT
    line = ReferenceLine.straight(Pose(-EGO_START, 0.0, 0.0), total)
    section = Section(2, 2, lane_width=float(rng.uniform(3.25, 3.4)), edge=0.35)
    crossing = EGO_START + length * float(rng.uniform(0.55, 0.75)) + 12.0
    way = int(rng.choice([-1, 1]))
    roads = tee(line, section, Section(1, 1, lane_width=3.3), crossing, way, TOWN_SPEED, fillet=7.0)
    return StreetLayout(roads.network, roads.route(2), TOWN_SPEED - 1.5, TOWN_EDGE)


def _furnish_straight(site: Site, main: Road, ahead: Road, side: Road) -> None:
    rng = site.rng
    sign(site, main, main.end - 1.0, -1, "warning")
    sign(site, side, side.start + 1.0, 1, "yield")
    sign(site, main, 95.0, -1, "speed", speed=50)
    sign(site, ahead, ahead.start + 20.0, -1, "parking")
    lamps(site, main, (1, -1), 34.0, 8.5, 2.2)
    lamps(site, ahead, (1, -1), 34.0, 8.5, 2.2)
    crowns = trees(rng, (5.0, 6.0), ("round",), 4) + trees(rng, (7.0, 8.5), ("tall",), 2)
    kinds = (scenery.litter_bin, scenery.hydrant, scenery.parking_meter, scenery.bollard)
    small = [Prop.of(make(rng)) for make in kinds]
    benches = several(rng, scenery.bench, 2)
    for road in (main, ahead):
        for way in (1, -1):
            site.row(road, way, crowns, 16.0, 1.6, jitter=0.9, turn=None, share=0.85, overlap=0.35)
            site.row(road, way, small, 14.0, 0.6, jitter=4.0, share=0.8)
            site.row(road, way, benches, 45.0, 2.6, jitter=8.0)


def signalled_intersection(rng: Generator, length: float) -> Site:
    """Build the street."""
    layout_rng, site_rng = rng.spawn(2)
    site = Site(_crossing_layout(layout_rng, length), site_rng)
    roads = [site.road(name) for name in ("main", "ahead", "left", "right")]
    for road in roads:
        ends = (False, True) if road.name == "main" else (True, False)
        paint_road(site, road, RoadPaint("double", edges=False, solid=30.0), ends)
        arm = JunctionArm(road, road.name == "main")
        paint_arm(site, arm, "stop", zebra=True, arrows=("straight-left", "straight-right"))
        _signals(site, arm, "green" if road.name in ("main", "ahead") else "red")
    for road in roads:
        first = CROSSING_HOUSES if site.rng.random() < 0.6 else CROSSING_OFFICES
        for way in (1, -1):
            begin = road.paved[0] + (0.0 if road.name == "main" else 24.0)
            end = road.paved[1] - (24.0 if road.name == "main" else 0.0)
            build_along(site, road, way, first, begin, end)
            joints(site, road, way, 4.6)
        far = (road.paved[0], -1) if road.name == "main" else (road.paved[1], 1)
        close_view(site, road, *far, CROSSING_HOUSES)
        _furnish_crossing(site, road)
    woods(site, 0.4, 16.0)
    return site


def _crossing_layout(rng: Generator, length: float) -> StreetLayout:
    turn = str(rng.choice(["left", "right"]))
    section = Section(2, 2, lane_width=3.4, edge=0.35)
    half = section.kerb(1) + FILLET + 5.0
    crossing = EGO_START + max(26.0, 0.3 * length) + half
    rest = length + EGO_START + RUN_OUT - crossing + half
    line = ReferenceLine.straight(Pose(-EGO_START, 0.0, 0.0), crossing + 150.0)
    centre = line.pose(crossing)
    main = Road("main", line, section, 0.0, crossing - half, TOWN_SPEED, (0.0, crossing))
    ahead = Road(
        "ahead", line, section, crossing + half, line.length, TOWN_SPEED, (crossing, line.length)
    )
    arms = [JunctionArm(main, True), JunctionArm(ahead, False)]
    for name, way in (("left", 1), ("right", -1)):
        reach = rest if name == turn else 130.0
        cross = ReferenceLine.straight(centre._replace(heading=way * np.pi / 2), reach)
        road = Road(name, cross, section, half, reach, TOWN_SPEED, (0.0, reach))
        arms.append(JunctionArm(road, False))
    network = StreetNetwork([arm.road for arm in arms])
    network.junction("crossing", arms, right_reach=FILLET + 3.5)
    exit_road = network.roads[turn]
    index = 1 if turn == "left" else 2
    route = network.route(
        main.lane_id(0, index), exit_road.lane_id(len(exit_road.blocks()) - 2, index)
    )
    return StreetLayout(network, route, 11.0, TOWN_EDGE, FILLET)


def _signals(site: Site, arm: JunctionArm, state: str) -> None:
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


def _furnish_crossing(site: Site, road: Road) -> None:
    rng = site.rng
    lamps(site, road, (1, -1), 34.0, 8.5, 2.2)
    crowns = trees(rng, (5.0, 6.0), ("round",), 2) + trees(rng, (7.0, 8.5), ("tall",), 1)
    kinds = (scenery.litter_bin, scenery.hydrant, scenery.bollard, scenery.bench)
    small = [Prop.of(make(rng)) for make in kinds]
    sign(site, road, (road.start + road.end) / 2, -1, "speed", speed=50)
    for way in (1, -1):
        start, end = road.start + 8, road.end - 8
        site.row(road, way, crowns, 17.0, 1.6, start, end, 0.9, None, overlap=0.35, share=0.75)
        site.row(road, way, small, 16.0, 0.6, jitter=4.0, share=0.8)


def parked_street(rng: Generator, length: float) -> Site:
    """Build the street."""
    layout_rng, site_rng = rng.spawn(2)
    site = Site(_parked_layout(layout_rng, length), site_rng)
    main, ahead, side = site.road("main"), site.road("ahead"), site.road("side")
    for road, ends in ((main, (False, True)), (ahead, (True, False))):
        paint_road(site, road, RoadPaint("dashed", edges=False, solid=10.0, dash=2, gap=4), ends)
        for way in (1, -1):
            park_along(site, road, way, _places(road)[0], 0.92, PITCH)
            joints(site, road, way, 3.0)
    paint_road(site, side, RoadPaint("none", edges=False), (True, False))
    paint_arm(site, JunctionArm(side, False), "yield", zebra=False)
    paint_arm(site, JunctionArm(main, True), "none", zebra=True)
    sign(site, side, side.start + 0.5, 1, "yield")
    sign(site, main, EGO_START + 14.0, -1, "parking")
    sign(site, ahead, ahead.start + 12.0, -1, "parking")
    sign(site, main, EGO_START - 12.0, -1, "speed", speed=30)
    for way in (1, -1):
        build_along(site, main, way, NARROW_HOUSES, 0.0, ahead.paved[1])
        build_along(site, side, way, NARROW_HOUSES, 18.0, side.paved[1])
        joints(site, side, way, 3.0)
    close_view(site, side, side.paved[1], 1, NARROW_HOUSES)
    close_view(site, ahead, ahead.paved[1], 1, NARROW_HOUSES)
    close_view(site, main, 0.0, -1, NARROW_HOUSES)
    _furnish_parked(site, main, ahead)
    woods(site, 0.5, 14.0)
    return site


def _parked_layout(rng: Generator, length: float) -> StreetLayout:
    total = EGO_START + length + RUN_OUT
    bend = float(rng.choice([-1.0, 1.0])) / rng.uniform(350, 600)
    line = ReferenceLine.from_bends(
        Pose(-EGO_START, 0.0, 0.0), [(EGO_START + 0.4 * length, 0.0), (total, bend)], 60.0
    ).part(0.0, total)
    section = Section(1, 1, lane_width=3.25, parking_right=2.2, parking_left=2.2, edge=0.1)
    crossing = EGO_START + length * float(rng.uniform(0.6, 0.75)) + 14.0
    way = int(rng.choice([-1, 1]))
    roads = tee(line, section, Section(1, 1, lane_width=3.2), crossing, way, NARROW_SPEED, 5.0)
    islands = []
    for road in (roads.main, roads.ahead):
        for side in (1, -1):
            islands += [_build_out(road, s, side) for s in _places(road)[1]]
    wear = Wear((0.12, 0.118, 0.115), patches=6.0, cracks=12.0, covers=3.5, tracks=0.6)
    return StreetLayout(
        roads.network, roads.route(1), NARROW_SPEED - 0.3, NARROW_EDGE, 5.0, tuple(islands), wear
    )


def _places(road: Road) -> tuple[list[float], list[float]]:
    """Parking places, and those that a tree takes instead."""
    return bays(road.start + 2.0, road.end - 4.0, PITCH, BLOCK)


def _build_out(road: Road, s: float, side: int) -> Island:
    section = road.section
    inner, outer = section.lanes_edge(side) + side * 0.5, section.kerb(side) + side * 0.05
    half = PITCH / 2 - 0.4
    places = [s - half, s - half + 0.8, s + half - 0.8, s + half]
    return Island(shapely.Polygon(road.point(places, [outer, inner, inner, outer])))


def _furnish_parked(site: Site, main: Road, ahead: Road) -> None:
    rng = site.rng
    # Only narrow crowns fit between a lane and the houses.
    crowns = trees(rng, (5.5, 8.5), ("tall",), 6)
    meters = (scenery.parking_meter, scenery.parking_meter)
    kinds = (scenery.litter_bin, *meters, scenery.bollard, scenery.bench)
    small = [Prop.of(make(rng)) for make in kinds]
    for road in (main, ahead):
        lamps(site, road, (1, -1), 30.0, 6.5, 1.2)
        for way in (1, -1):
            for s in _places(road)[1]:
                crown = crowns[int(rng.integers(len(crowns)))]
                spot = site.beside(road, s, way, -0.45)
                turned = Pose(spot.x, spot.y, float(rng.uniform(0, 2 * np.pi)))
                site.placer.place(crown, turned, overlap=0.5)
            site.row(road, way, small, 11.0, 0.5, jitter=3.0, share=0.8)
