"""Streets of a town: straight, crossing with lights, and narrow with cars parked along it."""

from __future__ import annotations

from functools import partial

import numpy as np
import shapely
from numpy.random import Generator

from recast.synthetic import scenery
from recast.synthetic.streets.network import (
    JunctionArm,
    RoadPaint,
    StreetNetwork,
    bays,
    paint_arm,
    paint_road,
    park_along,
    tee,
)
from recast.synthetic.streets.road import Road, Section, Wear
from recast.synthetic.streets.shapes import (
    GRASS,
    GRAVEL,
    PAVING,
    SOIL,
    Band,
    Edge,
    Island,
    Pose,
    ReferenceLine,
    flat,
)
from recast.synthetic.streets.site import (
    EGO_START,
    RUN_OUT,
    Frontage,
    Prop,
    Site,
    StreetLayout,
    build_along,
    close_view,
    driveway,
    joints,
    lamps,
    line_along,
    several,
    sign,
    trees,
    woods,
)
from recast.synthetic.surface import Surface

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


RURAL_EDGE = Edge(
    kerb=False,
    bands=(
        Band(0.9, GRAVEL, -0.02),
        Band(1.4, GRASS, -0.25),
        Band(0.9, ((0.07, 0.11, 0.03), "grass"), -0.30),
        Band(1.8, ((0.14, 0.15, 0.05), "grass"), 0.0),
    ),
    land=((0.10, 0.14, 0.04), "grass"),
    hills=38.0,
)
CROPS = (
    ((0.26, 0.21, 0.08), "grass"),
    SOIL,
    ((0.07, 0.13, 0.03), "grass"),
    ((0.30, 0.27, 0.05), "grass"),
    ((0.17, 0.17, 0.06), "grass"),
)
RURAL_SPEED = 16.7
SUBURBAN_EDGE = Edge(True, (Band(1.5, GRASS), Band(1.7, PAVING)), GRASS, hills=20.0)
SUBURBAN_HOUSES = Frontage("suburban", (8.5, 11.0), (9.5, 14.0), (8.0, 11.0), (6.0, 9.0))
SUBURBAN_SPEED = 11.1


def rural_two_lane(rng: Generator, length: float) -> Site:
    """Build the street."""
    layout_rng, site_rng = rng.spawn(2)
    site = Site(_rural_layout(layout_rng, length), site_rng)
    main, ahead, side = site.road("main"), site.road("ahead"), site.road("side")
    paint_road(site, main, RoadPaint("dashed", dash=4.0, gap=8.0), (False, True))
    paint_road(site, ahead, RoadPaint("dashed", dash=4.0, gap=8.0), (True, False))
    site.markings.line(main, main.end, ahead.start, main.section.lanes_edge(_far(side)), 0.14)
    paint_arm(site, JunctionArm(side, False), "yield", zebra=False)
    sign(site, side, side.start + 1.0, 1, "yield", away=1.5)
    sign(site, main, EGO_START + 20.0, -1, "speed", away=1.5, speed=70)
    sign(site, main, main.end - 45.0, -1, "warning", away=1.5)
    sign(site, main, main.end - 18.0, -1, "direction", away=3.4)
    for road in (main, ahead):
        for way in (1, -1):  # marker posts with reflectors
            site.row(road, way, several(site.rng, scenery.bollard, 1), 25.0, 0.75)
    way = int(site.rng.choice([-1, 1]))
    for road in (main, ahead):
        start, end = road.paved[0] + 5.0, road.paved[1] - 2.0
        line_along(site, road, way, 8.5, partial(_span, site.rng), start, end, piece=38.0)
    _rails(site, main)
    _rails(site, ahead)
    _farm(site, side)
    _fields(site)
    _rural_trees(site, main, ahead)
    woods(site, 0.9, 12.0)
    return site


def _rural_layout(rng: Generator, length: float) -> StreetLayout:
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
    roads = tee(line, section, minor, crossing, -int(way), RURAL_SPEED, 8.0, zebra=False)
    wear = Wear((0.15, 0.148, 0.143), patches=3.5, cracks=11.0, covers=0.0, tracks=1.1)
    return StreetLayout(
        roads.network, roads.route(1), RURAL_SPEED - 2.7, RURAL_EDGE, 8.0, wear=wear
    )


def _far(side: Road) -> int:
    """The side of the main road that faces the side road."""
    return -1 if np.sin(side.line.headings[0]) > 0 else 1


def _span(rng: Generator, length: float) -> Surface:
    """Wires on two poles."""
    return scenery.pole_line(rng, length, length)


def _rails(site: Site, road: Road) -> None:
    """Guard rails along the outside of the sharpest part of each bend."""
    s = np.arange(road.start + 12.0, road.end - 12.0, 8.0)
    turn = np.gradient(road.line.heading(s), s)
    for at, curvature in zip(s, turn, strict=True):
        if abs(curvature) > 1 / 360:
            side, rail = -int(np.sign(curvature)), partial(scenery.guard_rail, site.rng)
            line_along(site, road, side, 1.1, rail, at, at + 8.0, piece=9.0)


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
    clear = site.ground.filled.buffer(RURAL_EDGE.width + 1.0)
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


def _rural_trees(site: Site, main: Road, ahead: Road) -> None:
    rng = site.rng
    crowns = trees(rng, (7.0, 11.0), ("round", "round", "conifer", "tall"), 6)
    far = trees(rng, (8.0, 13.0), ("conifer", "round", "conifer"), 4, detail=0.5)
    bushes = [Prop.of(scenery.bush(rng, float(rng.uniform(0.8, 1.6)))) for _ in range(4)]
    for road in (main, ahead):
        for way in (1, -1):
            site.row(road, way, crowns, 26.0, 7.0, jitter=9.0, turn=None, share=0.55)
            site.row(road, way, bushes, 11.0, 5.6, jitter=4.0, turn=None, share=0.5)
            for away, share in ((26.0, 0.3), (48.0, 0.5), (78.0, 0.6)):
                site.row(road, way, far, 22.0, away, jitter=18.0, turn=None, share=share)


def suburban_curve(rng: Generator, length: float) -> Site:
    """Build the street."""
    layout_rng, site_rng = rng.spawn(2)
    site = Site(_suburban_layout(layout_rng, length), site_rng)
    main, ahead, side = site.road("main"), site.road("ahead"), site.road("side")
    paint = RoadPaint("dashed", edges=False, solid=14.0)
    paint_road(site, main, paint, (False, True))
    paint_road(site, ahead, paint, (True, False))
    paint_road(site, side, RoadPaint("none", edges=False), (True, False))
    paint_arm(site, JunctionArm(side, False), "stop", zebra=False)
    sign(site, side, side.start + 0.5, 1, "stop")
    sign(site, main, EGO_START + 16.0, -1, "speed", speed=40)
    sign(site, main, main.end - 30.0, -1, "warning")
    for road, end in ((main, ahead.paved[1]), (side, side.paved[1])):
        for way in (1, -1):
            _plots(site, road, way, 22.0 if road is side else 0.0, end)
    for road in (main, ahead):
        places = bays(road.start + 4, road.end - 6, 9.0, 3)[0]
        for way in (1, -1):
            park_along(site, road, way, places, 0.35, ticks=False)
        lamps(site, road, (1 if main.line.length % 2 < 1 else -1,), 36.0, 6.5, 1.4)
        _suburban_trees(site, road)
    woods(site, 0.9, 13.0)
    return site


def _suburban_layout(rng: Generator, length: float) -> StreetLayout:
    total = EGO_START + length + RUN_OUT
    way = float(rng.choice([-1.0, 1.0]))
    first, second = way / rng.uniform(70, 110), -way / rng.uniform(80, 130)
    arc = float(np.clip(0.42 * length, 30.0, 90.0))
    bends = [(EGO_START + 0.06 * length, 0.0), (arc, first), (0.16 * length + 18.0, 0.0)]
    bends += [(arc, second), (total, 0.0)]
    line = ReferenceLine.from_bends(Pose(-EGO_START, 0.0, 0.0), bends, 26.0).part(0.0, total)
    section = Section(1, 1, lane_width=3.3, parking_right=2.2, parking_left=2.2, edge=0.15)
    crossing = EGO_START + 0.06 * length + arc + 0.08 * length + 9.0
    minor = Section(1, 1, lane_width=3.3)
    roads = tee(line, section, minor, crossing, -int(way), SUBURBAN_SPEED, 6.0, zebra=False)
    wear = Wear((0.135, 0.133, 0.13), patches=5.0, cracks=12.0, covers=2.0, tracks=0.7)
    speed = SUBURBAN_SPEED - 1.1
    return StreetLayout(roads.network, roads.route(1), speed, SUBURBAN_EDGE, 6.0, wear=wear)


def _plots(site: Site, road: Road, side: int, start: float, end: float) -> None:
    """Houses, each with a driveway, and hedges or fences along the pavement."""
    rng = site.rng
    last = start
    for _, house_end in build_along(site, road, side, SUBURBAN_HOUSES, start, end):
        drive = house_end + 2.4
        driveway(site, road, drive, side, 3.0, 13.0, (0.24, 0.23, 0.215))
        kind = str(rng.choice(_FENCES, p=[0.4, 0.2, 0.1, 0.1, 0.2]))
        make = partial(_boundary, site.rng, kind, float(rng.uniform(0.8, 1.4)))
        if kind != "open":
            away = SUBURBAN_EDGE.width + 0.6
            line_along(site, road, side, away, make, last, drive - 1.8, piece=5.0)
        last = drive + 2.0


_FENCES = ("hedge", "picket", "wood", "wall", "open")


def _boundary(rng: Generator, kind: str, height: float, length: float) -> Surface:
    if kind == "hedge":
        return scenery.hedge(rng, length, height)
    if kind == "wall":
        return scenery.wall(rng, length, 0.8, "stone")
    return scenery.fence(rng, length, kind)


def _suburban_trees(site: Site, road: Road) -> None:
    rng = site.rng
    crowns = trees(rng, (6.0, 9.0), ("round", "conifer", "round", "tall"), 6)
    bushes = several(rng, lambda r: scenery.bush(r, float(r.uniform(0.7, 1.3))), 4)
    for way in (1, -1):
        row = partial(site.row, road, way, turn=None)
        row(crowns[:1] + crowns[2:3], 19.0, 0.8, jitter=1.5, share=0.5)
        row(crowns, 13.0, 6.6, jitter=3.0, share=0.45, off_pavement=True)
        row(crowns, 15.0, 24.0, jitter=6.0, share=0.7)
        row(bushes, 8.0, 7.4, jitter=2.0, share=0.5)
        site.row(road, way, several(rng, scenery.hydrant, 1), 80.0, 0.6, jitter=10.0)
