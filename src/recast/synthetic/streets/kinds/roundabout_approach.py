"""A road that leads to a roundabout; the ego drives half round it and on."""

from __future__ import annotations

import itertools

import numpy as np
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
)  # fmt: skip
from recast.synthetic.streets.ground import GRASS, KERB_HEIGHT, PAVING, Band, Edge, Island
from recast.synthetic.streets.network import Arm
from recast.synthetic.streets.paint import RoadPaint, paint_arm, paint_road
from recast.synthetic.streets.placement import Prop
from recast.synthetic.streets.reference_line import Pose
from recast.synthetic.streets.road import Road
from recast.synthetic.streets.roundabout import Roundabout, make_roundabout
from recast.synthetic.streets.site import EGO_START, RUN_OUT, Layout, Site
from recast.synthetic.streets.triangles import ribbon
from recast.synthetic.surface import Surface, concatenate

EDGE = Edge(
    kerb=True,
    bands=(Band(1.6, GRASS, "grass"), Band(2.0, PAVING, "concrete")),
    land=(GRASS, "grass"),
    hills=18.0,
)
HOUSES = Frontage("suburban", (9.0, 14.0), (10.0, 14.0), (8.0, 11.0), (7.0, 14.0))
SPEED = 11.1


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
        arm = Arm(road, entering)
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
            line_along(
                site, road, side, EDGE.width + 0.6, lambda n: scenery.hedge(site.rng, n, 1.2),
                start, end, piece=6.0, chance=0.55,
            )  # fmt: skip
        lamps(site, road, (1, -1), 38.0, 8.0, 1.8)
        _plant(site, road)
    woods(site, 0.9, 12.0)
    return site


def _layout(rng: Generator, length: float) -> tuple[Roundabout, Layout]:
    approach = EGO_START + max(40.0, 0.42 * length)
    beyond = length + RUN_OUT - (approach - EGO_START)
    side = float(rng.uniform(75, 90))
    angles = (np.pi, -np.pi / 2 + rng.uniform(-0.2, 0.2), 0.0, np.pi / 2 + rng.uniform(-0.2, 0.2))
    round_ = make_roundabout(
        Pose(approach - EGO_START + 24.0, 0.0, 0.0),
        radius=float(rng.uniform(17.0, 20.0)),
        arms=tuple(zip(("main", "right", "ahead", "left"), angles,
                       (approach, side, beyond, side), strict=True)),
        speed=SPEED,
    )  # fmt: skip
    network = round_.network
    ahead = network.roads["ahead"]
    route = network.route(
        network.roads["main"].lane_id(0, 1), ahead.lane_id(len(ahead.blocks()) - 2, 1)
    )
    islands = (
        Island(round_.centre_disc, GRASS, "grass"),
        *(Island(outline, PAVING, "concrete") for outline in round_.splitters),
    )
    layout = Layout(network, route, 9.5, EDGE, 6.0, islands, paved=(round_.disc,))
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
    return concatenate(
        [ribbon(near, far, GRASS, "grass") for near, far in itertools.pairwise(rings)]
    )


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
        site.row(road, side, crowns, 15.0, 6.8, jitter=3.0, turn=None, chance=0.5,
                 off_pavement=True)  # fmt: skip
        site.row(road, side, crowns, 18.0, 25.0, jitter=6.0, turn=None, chance=0.6)
