"""A street under construction: layout first, then ground, then props where there is room beside."""

from __future__ import annotations

import itertools
from collections.abc import Callable, Sequence
from dataclasses import dataclass, field

import numpy as np
import shapely
from numpy.random import Generator

from recast.arrays import Array
from recast.logs import HdMap
from recast.synthetic import scenery
from recast.synthetic.streets.network import Markings, StreetNetwork
from recast.synthetic.streets.road import Road, Wear, wear_road, wear_turns
from recast.synthetic.streets.shapes import (
    KERB_HEIGHT,
    Colour,
    Decals,
    Edge,
    Ground,
    Island,
    Pose,
    forest_belt,
    placed,
    without_holes,
)
from recast.synthetic.surface import Surface, at, concatenate
from recast.synthetic.world import ParkingSpot, Street, daylight

HEADROOM = 4.5
"""Metres above the lanes that stay free."""
_VAN_HEIGHT = 2.6
"""Metres above all other asphalt that stay free."""
_KERB_CLEARANCE = 0.12
_OVERLAP = 0.12
"""Share of the smaller of two outlines by which they may overlap, seen from above."""
EGO_START = 80.0
"""Metres of `ego_route` before the place from which the ego drives `length` metres."""
RUN_OUT = 200.0
"""Metres of `ego_route` after that."""


@dataclass(frozen=True)
class Prop:
    """A thing that may stand somewhere, with its outlines seen from above in its own frame."""

    surface: Surface  # surface of the prop, as the scenery functions give it
    foot: shapely.Geometry  # hull of what reaches below the height of a van
    low: shapely.Geometry  # hull of what reaches below the headroom
    whole: shapely.Geometry  # hull of all

    @classmethod
    def of(cls, surface: Surface) -> Prop:
        """A prop from its triangles."""
        lowest = surface.vertices[surface.faces, 2].min(axis=1)
        foot, low = (
            _hull(surface.vertices[surface.faces[lowest < height].ravel(), :2])
            for height in (_VAN_HEIGHT, HEADROOM)
        )
        return cls(surface, foot, low, _hull(surface.vertices[:, :2]))


def _hull(points: Array) -> shapely.Geometry:
    # One chain of points: to make many points of their own takes ten times as long.
    return shapely.convex_hull(shapely.linestrings(points))


class Placer:
    """Places props one after the other, each clear of the road and of those before.

    Attributes:
        placed: the surfaces, in the world frame.
    """

    def __init__(self, ground: Ground, lanes: shapely.Geometry) -> None:
        self.placed: list[Surface] = []
        self._ground = ground
        self._road = ground.asphalt.buffer(_KERB_CLEARANCE)
        self._lanes = lanes.buffer(0.05)
        shapely.prepare(self._road)
        shapely.prepare(self._lanes)
        self._outlines: list[shapely.Geometry] = []
        self._bounds: list[tuple[float, float, float, float]] = []

    def reserve(self, outline: shapely.Geometry) -> None:
        """Keep an area free of whatever comes later."""
        self._outlines.append(outline)
        self._bounds.append(outline.bounds)

    def place(
        self,
        prop: Prop,
        pose: Pose,
        keep_off: shapely.Geometry | None = None,
        overlap: float = _OVERLAP,
        lift: float = 0.0,
    ) -> bool:
        """Put a prop on the ground at a pose; False where there is no room.

        Args:
            prop: what to place.
            pose: pose of the prop's origin.
            keep_off: an area, besides the road, that it must not touch; prepared, for speed.
            overlap: share of the smaller of two outlines by which they may overlap.
            lift: metres above the ground at which it stands.
        """
        foot, low, whole = (placed(part, pose) for part in (prop.foot, prop.low, prop.whole))
        if self._road.intersects(foot) or self._lanes.intersects(low):
            return False
        if keep_off is not None and keep_off.intersects(foot):
            return False
        if self._collides(whole, overlap):
            return False
        self.reserve(whole)
        z = lift + float(self._ground.height(np.array([[pose.x, pose.y]]))[0])
        self.placed.append(at(prop.surface, pose.x, pose.y, z, pose.heading))
        return True

    def _collides(self, outline: shapely.Geometry, overlap: float) -> bool:
        if not self._bounds:
            return False
        low_x, low_y, high_x, high_y = outline.bounds
        box = np.array(self._bounds)
        near = (box[:, 0] < high_x) & (box[:, 2] > low_x)
        near &= (box[:, 1] < high_y) & (box[:, 3] > low_y)
        for index in np.flatnonzero(near):
            other = self._outlines[index]
            least = min(outline.area, other.area)
            if outline.intersection(other).area > overlap * least:
                return True
        return False


@dataclass(frozen=True)
class StreetLayout:
    """Roads of a scene, before anything stands on them."""

    network: StreetNetwork  # roads and lanes
    route: tuple[str, ...]  # ids of the ego's lanes
    speed: float  # m/s of the ego on a free road
    edge: Edge  # what lies beside the asphalt
    fillet: float = 7.0  # radius of kerbs at corners, metres
    islands: tuple[Island, ...] = ()  # raised areas
    wear: Wear = field(default_factory=Wear)  # wear of the asphalt
    paved: tuple[shapely.Geometry, ...] = ()  # asphalt besides the roads' and lanes' own


class Site:
    """A layout with its ground, to be marked and furnished.

    Attributes:
        layout: the roads.
        ground: shape of the ground.
        rng: source of what stands where.
        markings: painter.
        placer: placer of props.
        decals: thin shapes on the ground.
        public: asphalt, verges and pavements.
        core: part of `public` that awnings and steps of buildings do not reach into.
        parking: spots for parked cars.
        extras: further surfaces in the world frame.
    """

    def __init__(self, layout: StreetLayout, rng: Generator) -> None:
        self.layout = layout
        self.rng = rng
        self._ground_rng, self._wear_rng, self._sky_rng, paint_rng = rng.spawn(4)
        lanes = layout.network.lanes.values()
        paved = [road.carriageway() for road in layout.network.roads.values()]
        paved += [shapely.Polygon(lane.polygon) for lane in lanes if lane.is_intersection]
        self.ground = Ground.make(
            [*paved, *layout.paved], layout.islands, layout.edge, layout.wear.colour, layout.fillet
        )
        self.decals = Decals()
        self.markings = Markings(self.decals, paint_rng)
        driven = shapely.union_all([shapely.Polygon(lane.polygon) for lane in lanes])
        self.placer = Placer(self.ground, driven)
        self.public = self.ground.filled.buffer(layout.edge.width - 0.6)
        self.core = self.ground.filled.buffer(max(layout.edge.width - 2.4, 0.2))
        shapely.prepare(self.public)
        shapely.prepare(self.core)
        self.parking: list[ParkingSpot] = []
        self.extras: list[Surface] = []

    def road(self, name: str) -> Road:
        """A road of the layout."""
        return self.layout.network.roads[name]

    def beside(self, road: Road, s: float, side: int, away: float) -> Pose:
        """A pose `away` metres outside the kerb whose -y looks at the road."""
        lateral = road.section.kerb(side) + side * away
        return road.pose(s, lateral, reverse=side < 0)

    def row(
        self,
        road: Road,
        side: int,
        props: Sequence[Prop],
        spacing: float,
        away: float,
        start: float | None = None,
        end: float | None = None,
        jitter: float = 0.0,
        turn: float | None = 0.0,
        off_pavement: bool = False,
        overlap: float = 0.12,
        share: float = 1.0,
    ) -> None:
        """Props along a road.

        Args:
            side: +1 left, -1 right.
            props: one is drawn for each place.
            spacing: metres between them.
            away: metres outside the kerb.
            start, end: arc lengths; the road's by default.
            jitter: metres by which places vary along the road, a third of it across.
            turn: radians added to the heading; None for any.
            off_pavement: keep clear of the pavement and verges too.
            overlap: share by which outlines may overlap, as in `Placer.place`.
            share: share of the places that have a prop.
        """
        begin = (road.start if start is None else start) + self.rng.uniform(0.2, 0.8) * spacing
        for s in np.arange(begin, road.end if end is None else end, spacing):
            place = float(s) + self.rng.uniform(-jitter, jitter)
            out = away + self.rng.uniform(-jitter, jitter) / 3
            prop = props[int(self.rng.integers(len(props)))]
            angle = self.rng.uniform(0, 2 * np.pi) if turn is None else turn
            if self.rng.random() > share:
                continue
            pose = self.beside(road, place, side, max(out, 0.3) if away > 0 else out)
            pose = Pose(pose.x, pose.y, pose.heading + angle)
            self.placer.place(prop, pose, self.public if off_pavement else None, overlap)

    def finish(self, kind: str, elevation: tuple[float, float]) -> Street:
        """The street; no changes after this."""
        network, wear = self.layout.network, self.layout.wear
        for road in network.roads.values():
            wear_road(self.decals, road, wear, self._wear_rng)
        turning = [lane for lane in network.lanes.values() if lane.is_intersection]
        if turning:
            worn = shapely.union_all(
                [
                    shapely.Polygon(lane.polygon)
                    for lane in network.lanes.values()
                    if not lane.is_intersection
                ]
            )
            wear_turns(self.decals, turning, wear, worn)
        surface = concatenate(
            [
                *self.ground.surfaces(self._ground_rng),
                self.decals.surface(),
                *self.placer.placed,
                *self.extras,
            ]
        )
        outlines = [
            shapely.get_coordinates(shapely.orient_polygons(part).exterior)[:-1]
            for part in without_holes(self.ground.asphalt)
        ]
        return Street(
            kind=kind,
            surface=surface,
            map=HdMap(
                lanes=dict(network.lanes),
                drivable_area=tuple(outlines),
                ground=self.ground.grid(),
                notes={"source": f"recast synthetic street {kind}"},
            ),
            ego_route=self.layout.route,
            ego_speed=self.layout.speed,
            parking=tuple(self.parking),
            sky=daylight(self._sky_rng, elevation),
        )


@dataclass(frozen=True)
class Frontage:
    """A row of buildings."""

    style: str  # see `scenery.building`
    away: tuple[float, float]  # metres from the kerb to the facades; a range
    # width, depth: metres; ranges.
    width: tuple[float, float]
    depth: tuple[float, float]
    gap: tuple[float, float] = (0.0, 0.0)  # metres between buildings; a range
    storeys: tuple[int, int] | None = None  # a range, or None to leave it to the style


def build_along(
    site: Site, road: Road, side: int, frontage: Frontage, start: float, end: float
) -> list[tuple[float, float]]:
    """Buildings along one side of a road; returns the arc lengths (start, end) of each."""
    rng, built = site.rng, []
    s = start
    while s < end - frontage.width[0]:
        width = float(rng.uniform(*frontage.width))
        depth, away = float(rng.uniform(*frontage.depth)), float(rng.uniform(*frontage.away))
        pose = site.beside(road, s + width / 2, side, away)
        body = shapely.box(-width / 2, 0, width / 2, depth)
        if site.ground.filled.intersects(placed(body, pose)):
            s += 3.0
            continue
        storeys = None if frontage.storeys is None else int(rng.integers(*frontage.storeys))
        house = scenery.building(rng, width, depth, frontage.style, storeys)
        if site.placer.place(Prop.of(house), pose, site.core, overlap=0.1):
            built.append((s, s + width))
            s += width + float(rng.uniform(*frontage.gap))
        else:
            s += 3.0
    return built


def several(rng: Generator, make: Callable[[Generator], Surface], count: int) -> list[Prop]:
    """`count` variants of something."""
    return [Prop.of(make(rng)) for _ in range(count)]


def trees(
    rng: Generator,
    height: tuple[float, float],
    styles: tuple[str, ...] = ("round",),
    count: int = 5,
    detail: float = 1.0,
) -> list[Prop]:
    """Variants of trees."""
    made = []
    for k in range(count):
        style = styles[k % len(styles)]
        made.append(Prop.of(scenery.tree(rng, float(rng.uniform(*height)), style, detail)))
    return made


def lamps(
    site: Site, road: Road, sides: tuple[int, ...], spacing: float, height: float, reach: float
) -> None:
    """Lamp posts, on both sides in turn where there are two."""
    prop = Prop.of(scenery.lamp_post(site.rng, height, reach))
    for k, side in enumerate(sides):
        begin = road.start + spacing * (0.2 + k / max(len(sides), 1))
        for s in np.arange(begin, road.end, spacing):
            for shift in (0.0, 2.0, -2.0, 4.0, -4.0):
                pose = site.beside(road, float(s) + shift, side, 0.55)
                if site.placer.place(prop, pose):
                    break


def sign(
    site: Site, road: Road, s: float, side: int, kind: str, away: float = 0.7, speed: int = 50
) -> bool:
    """A sign for the traffic on one side of a road; tries a few places nearby."""
    prop = Prop.of(scenery.road_sign(site.rng, kind, speed))
    for shift in (0.0, 1.5, -1.5, 3.0, -3.0, 5.0):
        spot = site.beside(road, s + shift, side, away)
        heading = float(road.line.heading(s + shift)) + (np.pi if side > 0 else 0.0)
        if site.placer.place(prop, Pose(spot.x, spot.y, heading)):
            return True
    return False


def joints(site: Site, road: Road, side: int, width: float, pitch: float = 1.9) -> None:
    """Dark joints between the slabs of a pavement that begins at the kerb."""
    height = KERB_HEIGHT - 0.0008
    kerb = road.section.kerb(side)
    tone = [0.17, 0.165, 0.15]
    covered = site.ground.filled.buffer(0.16)
    for s in np.arange(road.paved[0] + 1, road.paved[1] - 1, pitch):
        lateral = kerb + side * np.array([0.18, width - 0.1])
        ends = road.point(np.full(2, s), lateral)
        if not covered.disjoint(shapely.LineString(ends)):
            continue
        one = road.point(np.full(2, s + 0.012), lateral)
        other = road.point(np.full(2, s - 0.012), lateral)
        site.decals.strip(one, other, height, tone, "concrete")
    s = road.stations(road.paved[0] + 1, road.paved[1] - 1, 4.0)
    for out in np.arange(1.3, width - 0.4, 1.3):
        one = road.point(s, kerb + side * (out + 0.012))
        other = road.point(s, kerb + side * (out - 0.012))
        pieces = shapely.linestrings(np.stack([one[:-1], one[1:]], 1))
        for k in np.flatnonzero(~shapely.intersects(covered, pieces)):
            site.decals.strip(one[k : k + 2], other[k : k + 2], height, tone, "concrete")


def line_along(
    site: Site,
    road: Road,
    side: int,
    away: float,
    make: Callable[[float], Surface],
    start: float,
    end: float,
    piece: float = 8.0,
    share: float = 1.0,
) -> None:
    """Hedges, fences, rails or walls along a road, in straight pieces.

    Args:
        side: +1 left, -1 right.
        away: metres outside the kerb.
        make: function that makes a piece, along x, from its length in metres.
        start, end: arc lengths.
        piece: metres of a piece, about.
        share: share of the pieces that are there.
    """
    if end - start < 1.5:
        return
    lateral = road.section.kerb(side) + side * away
    edges = road.stations(start, end, piece)
    for a, b in itertools.pairwise(road.point(edges, lateral)):
        if side < 0:
            a, b = b, a
        if site.rng.random() >= share:
            continue
        heading = float(np.arctan2(b[1] - a[1], b[0] - a[0]))
        prop = Prop.of(make(float(np.hypot(*(b - a)))))
        site.placer.place(prop, Pose(float(a[0]), float(a[1]), heading), overlap=0.3)


def driveway(
    site: Site, road: Road, s: float, side: int, width: float, depth: float, colour: Colour
) -> None:
    """A paved way from the kerb to a plot."""
    laterals = road.section.kerb(side) + side * np.array([0.02, depth])
    ends = np.array([s - width / 2, s + width / 2])
    corners = np.stack([road.point(np.full(2, e), laterals) for e in ends])
    outline = shapely.Polygon([corners[0, 0], corners[1, 0], corners[1, 1], corners[0, 1]])
    outline = outline.difference(site.ground.filled)
    site.decals.polygon(outline, KERB_HEIGHT + 0.004, colour, "concrete")
    site.placer.reserve(outline)


def woods(site: Site, share: float, height: float = 11.0) -> None:
    """Belts of trees around the site, far off, over a share of the horizon."""
    low_x, low_y, high_x, high_y = site.ground.filled.bounds
    centre = np.array([(low_x + high_x) / 2, (low_y + high_y) / 2])
    radius = float(np.hypot(high_x - low_x, high_y - low_y)) / 2 + 75.0
    angle = float(site.rng.uniform(0, 2 * np.pi))
    end = angle + 2 * np.pi
    while angle < end:
        turn = float(site.rng.uniform(0.2, 0.7))
        if site.rng.random() < share:
            tall = height * float(site.rng.uniform(0.7, 1.3))
            away = radius + float(site.rng.uniform(-15.0, 10.0))
            site.extras.append(forest_belt(centre, away, angle, turn, tall, site.rng))
        angle += turn


def close_view(site: Site, road: Road, s: float, ahead: int, frontage: Frontage) -> None:
    """A building across the end of a road, so that one does not look into nothing."""
    width = min(max(2 * abs(road.section.kerb(1)) + 8, frontage.width[0]), 48.0)
    depth = float(site.rng.uniform(*frontage.depth))
    storeys = None if frontage.storeys is None else int(site.rng.integers(*frontage.storeys))
    spot = road.line.pose(s + ahead * 5.5)
    heading = spot.heading + (-np.pi / 2 if ahead > 0 else np.pi / 2)
    house = scenery.building(site.rng, width, depth, frontage.style, storeys)
    site.placer.place(Prop.of(house), Pose(spot.x, spot.y, heading), overlap=0.3)
