"""Streets of the outskirts: a wide arterial road, an underpass, and an industrial estate."""

from __future__ import annotations

import itertools
from dataclasses import dataclass
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
    paint_through,
    park_along,
    tee,
)
from recast.synthetic.streets.road import Road, Section, Wear
from recast.synthetic.streets.shapes import (
    GRASS,
    KERB_HEIGHT,
    PAVING,
    Band,
    Edge,
    Island,
    Pose,
    ReferenceLine,
    ribbon,
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
    lamps,
    line_along,
    several,
    sign,
    trees,
    woods,
)
from recast.synthetic.surface import Surface, at, concatenate

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


_LANE = 3.7
_RING_HALF = 3.3
"""Half the width of the ring's asphalt."""
_GAP = 7.0
"""Metres from the ring's asphalt to where the roads' lanes end."""
_JOIN = 0.56
"""Radians between an arm's axis and where its lanes leave and join the ring."""
_SPREAD = 2.3
"""Metres by which the lanes of a road move apart on both sides of the splitter island."""
EDGE = Edge(True, (Band(1.6, GRASS), Band(2.0, PAVING)), GRASS, hills=18.0)
HOUSES = Frontage("suburban", (9.0, 14.0), (10.0, 14.0), (8.0, 11.0), (7.0, 14.0))
SPEED = 11.1


@dataclass(frozen=True)
class Roundabout:
    """A roundabout and its roads."""

    network: StreetNetwork  # roads and lanes
    arms: tuple[Road, ...]  # its roads; the one named "main" ends here, all others begin here
    centre: tuple[float, float]  # x, y
    radius: float  # radius of the ring's middle
    # name, angle seen from the centre, and length of each road.
    spokes: tuple[tuple[str, float, float], ...]
    splitters: tuple[shapely.Polygon, ...]  # islands between the directions of each road

    @property
    def island_radius(self) -> float:
        """Metres from the centre to the kerb of the island in the middle."""
        return self.radius - _RING_HALF

    @property
    def disc(self) -> shapely.Polygon:
        """All within the outer edge of the ring."""
        return shapely.Point(self.centre).buffer(self.radius + _RING_HALF, quad_segs=24)

    @property
    def centre_disc(self) -> shapely.Polygon:
        """The island in the middle."""
        return shapely.Point(self.centre).buffer(self.island_radius, quad_segs=24)


def make_roundabout(
    centre: Pose, radius: float, arms: tuple[tuple[str, float, float], ...], speed: float
) -> Roundabout:
    """A roundabout with one lane.

    Args:
        centre: centre of the ring; its heading is not used.
        radius: radius of the ring's middle, metres.
        arms: name, angle seen from the centre in radians, and length in metres of each road, in
            counter-clockwise order. "main" leads to the ring, the others away from it.
        speed: limit on the roads, m/s.
    """
    section = Section(1, 1, lane_width=3.4, edge=0.35)
    inner = radius + _RING_HALF + _GAP
    roads = []
    for name, angle, length in arms:
        out = np.array([np.cos(angle), np.sin(angle)])
        near = np.array(centre[:2]) + inner * out
        if name == "main":
            far = near + length * out
            line = ReferenceLine.straight(Pose(far[0], far[1], angle + np.pi), length)
            near_end = ((length - 27.0, 0.0), (length - 4.0, _SPREAD), (length + _GAP, _SPREAD))
            spread = ((0.0, 0.0), *near_end)
            paved = (0.0, length + _GAP)
        else:
            line = ReferenceLine.straight(Pose(near[0], near[1], angle), length)
            spread = ((-_GAP, _SPREAD), (4.0, _SPREAD), (27.0, 0.0), (length, 0.0))
            paved = (-_GAP, length)
        roads.append(Road(name, line, section, 0.0, length, speed, paved, spread))
    network = StreetNetwork(roads)
    _link(network, roads, centre, radius, [angle for _, angle, _ in arms])
    return Roundabout(
        network,
        tuple(roads),
        (centre.x, centre.y),
        radius,
        arms,
        tuple(island for road in roads for island in _splitters(road)),
    )


def _link(
    network: StreetNetwork, roads: list[Road], centre: Pose, radius: float, angles: list[float]
) -> None:
    """Ring lanes from each exit to the entry beside it and on to the next exit, and joins."""
    middle = np.array(centre[:2])
    count = len(roads)
    for k, (road, angle) in enumerate(zip(roads, angles, strict=True)):
        gap = float(np.mod(angles[(k + 1) % count] - angle, 2 * np.pi))
        pieces = (("across", -_JOIN, 2 * _JOIN), ("round", _JOIN, gap - 2 * _JOIN))
        for piece, start, turn in pieces:
            line = ReferenceLine.circle(middle, radius, angle + start, turn)
            network.add(f"ring-{road.name}-{piece}", line, (_LANE, _LANE))
    for k, road in enumerate(roads):
        arm = JunctionArm(road, road.name == "main")
        following = roads[(k + 1) % count].name
        before = roads[k - 1].name
        across, after = f"ring-{road.name}-across", f"ring-{road.name}-round"
        network.follow(across, after)
        network.follow(after, f"ring-{following}-across")
        network.connect(f"enter-{road.name}", arm.incoming()[0], after)
        network.connect(f"leave-{road.name}", f"ring-{before}-round", arm.outgoing()[0])


def _splitters(road: Road) -> list[shapely.Polygon]:
    """Raised islands where a road's directions have moved apart, before and after a crossing."""
    start = road.end - 24.0 if road.name == "main" else road.start - 1.0
    s = road.stations(start, start + 25.0, 1.0)
    half = np.maximum(road.apart(s) - 0.35, 0.0)
    wide = half > 0.25
    s, half = s[wide], half[wide]
    rim = np.concatenate([road.line.offset(s, -half), road.line.offset(s, half)[::-1]])
    whole = shapely.Polygon(rim).buffer(-0.2).buffer(0.2)
    at = road.end - 8.0 if road.name == "main" else road.start + 8.0
    crossing = shapely.LineString(road.line.offset(np.full(2, at), np.array([-6.0, 6.0])))
    return list(shapely.get_parts(whole.difference(crossing.buffer(2.0, cap_style="flat"))))


def roundabout_approach(rng: Generator, length: float) -> Site:
    """Build the street."""
    layout_rng, site_rng = rng.spawn(2)
    round_, layout = _layout(layout_rng, length)
    site = Site(layout, site_rng)
    _middle(site, round_)
    for road in round_.arms:
        entering = road.name == "main"
        ends = (False, True) if entering else (True, False)
        paint_road(site, road, RoadPaint("dashed", solid=30.0), ends)
        arm = JunctionArm(road, entering)
        paint_arm(site, arm, "yield", zebra=False)
        at = road.end - 8.0 if entering else road.start + 8.0
        site.markings.zebra(road, at)
        way = -1 if entering else 1
        inwards = 1 if entering else -1
        near = road.end if entering else road.start
        sign(site, road, near - inwards * 1.0, way, "yield")
        sign(site, road, near - inwards * 40.0, way, "direction", away=2.6)
        sign(site, road, near - inwards * 60.0, way, "speed", speed=40)
        for side in (1, -1):
            start = 0.0 if entering else road.start + 10.0
            end = road.end - 10.0 if entering else road.end
            build_along(site, road, side, HOUSES, start, end)
            hedge, away = partial(scenery.hedge, site.rng, height=1.2), EDGE.width + 0.6
            line_along(site, road, side, away, hedge, start, end, piece=6.0, share=0.55)
        lamps(site, road, (1, -1), 38.0, 8.0, 1.8)
        _plant(site, road)
    woods(site, 0.9, 12.0)
    return site


def _layout(rng: Generator, length: float) -> tuple[Roundabout, StreetLayout]:
    approach = EGO_START + max(40.0, 0.42 * length)
    beyond = length + RUN_OUT - (approach - EGO_START)
    side = float(rng.uniform(75, 90))
    angles = (np.pi, -np.pi / 2 + rng.uniform(-0.2, 0.2), 0.0, np.pi / 2 + rng.uniform(-0.2, 0.2))
    names, lengths = ("main", "right", "ahead", "left"), (approach, side, beyond, side)
    arms = tuple(zip(names, angles, lengths, strict=True))
    centre = Pose(approach - EGO_START + 24.0, 0.0, 0.0)
    round_ = make_roundabout(centre, float(rng.uniform(17.0, 20.0)), arms, SPEED)
    network = round_.network
    ahead = network.roads["ahead"]
    route = network.route(
        network.roads["main"].lane_id(0, 1), ahead.lane_id(len(ahead.blocks()) - 2, 1)
    )
    islands = (
        Island(round_.centre_disc, GRASS),
        *(Island(outline, PAVING) for outline in round_.splitters),
    )
    layout = StreetLayout(network, route, 9.5, EDGE, 6.0, islands, paved=(round_.disc,))
    return round_, layout


_MOUND = 0.9
"""Metres that the middle of the central island rises above its kerb."""
_MOUND_SLOPE = ((0.35, 0.82), (1.0, 0.0))
"""Shares of the island's radius, and of the mound's height there."""


def _mound(round_: Roundabout) -> Surface:
    """Earth heaped on the central island."""
    angle = np.linspace(0.0, 2 * np.pi, 49)
    rim = np.stack([np.cos(angle), np.sin(angle)], axis=1)
    rings = []
    for share, height in ((0.0, 1.04), *zip(*_MOUND_SLOPE, strict=True)):
        xy = np.array(round_.centre) + round_.island_radius * max(share, 1e-3) * rim
        z = np.full(len(xy), KERB_HEIGHT - 0.004 + _MOUND * height)
        rings.append(np.concatenate([xy, z[:, None]], axis=1))
    return concatenate([ribbon(near, far, *GRASS) for near, far in itertools.pairwise(rings)])


def _middle(site: Site, round_: Roundabout) -> None:
    """Planting on the central island, and boards that show the way round."""
    rng = site.rng
    x, y = round_.centre
    inner = round_.island_radius
    site.extras.append(_mound(round_))
    tall = Prop.of(scenery.tree(rng, 8.5, "round"))
    site.placer.place(tall, Pose(x, y, float(rng.uniform(0, 6))), lift=_MOUND)
    bushes = several(rng, lambda r: scenery.bush(r, float(r.uniform(0.6, 1.1))), 4)
    for angle in np.arange(0.0, 2 * np.pi, 0.55):
        reach = float(rng.uniform(0.3, 0.75)) * inner
        spot = Pose(x + reach * np.cos(angle), y + reach * np.sin(angle), float(angle))
        lift = _MOUND * float(np.interp(reach / inner, *_MOUND_SLOPE))
        site.placer.place(bushes[int(rng.integers(4))], spot, lift=lift)
    for _, angle, _ in round_.spokes:
        face = angle + 0.28
        reach = inner - 0.9
        spot = Pose(x + reach * np.cos(face), y + reach * np.sin(face), angle + np.pi)
        site.placer.place(Prop.of(scenery.road_sign(rng, "warning")), spot)


def _plant(site: Site, road: Road) -> None:
    rng = site.rng
    crowns = trees(rng, (6.0, 9.0), ("round", "conifer", "tall"), 4, detail=0.8)
    for side in (1, -1):
        row = partial(site.row, road, side, crowns, turn=None)
        row(15.0, 6.8, jitter=3.0, share=0.5, off_pavement=True)
        row(18.0, 25.0, jitter=6.0, share=0.6)
