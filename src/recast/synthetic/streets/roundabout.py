"""Roundabouts: a ring driven counter-clockwise, and a street that leads to one."""

from __future__ import annotations

import itertools
from dataclasses import dataclass
from functools import partial

import numpy as np
import shapely
from numpy.random import Generator

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
)
from recast.synthetic.streets.ground import GRASS, KERB_HEIGHT, PAVING, Band, Edge, Island
from recast.synthetic.streets.markings import RoadPaint, paint_arm, paint_road
from recast.synthetic.streets.network import JunctionArm, StreetNetwork
from recast.synthetic.streets.road import Road, Section
from recast.synthetic.streets.shapes import Pose, ReferenceLine, ribbon
from recast.synthetic.streets.site import EGO_START, RUN_OUT, Prop, Site, StreetLayout
from recast.synthetic.surface import Surface, concatenate

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
    """A roundabout and its roads.

    Attributes:
        network: roads and lanes.
        arms: its roads; the one named "main" ends here, all others begin here.
        centre: x, y.
        radius: radius of the ring's middle.
        spokes: name, angle seen from the centre, and length of each road.
        splitters: islands between the directions of each road.
    """

    network: StreetNetwork
    arms: tuple[Road, ...]
    centre: tuple[float, float]
    radius: float
    spokes: tuple[tuple[str, float, float], ...]
    splitters: tuple[shapely.Polygon, ...]

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
_SLOPE = ((0.35, 0.82), (1.0, 0.0))
"""Shares of the island's radius, and of the mound's height there."""


def _mound(round_: Roundabout) -> Surface:
    """Earth heaped on the central island."""
    angle = np.linspace(0.0, 2 * np.pi, 49)
    rim = np.stack([np.cos(angle), np.sin(angle)], axis=1)
    rings = []
    for share, height in ((0.0, 1.04), *zip(*_SLOPE, strict=True)):
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
        lift = _MOUND * float(np.interp(reach / inner, *_SLOPE))
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
