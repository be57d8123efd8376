"""A street under construction: layout first, then ground, then props where there is room beside."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, field

import numpy as np
import shapely
from numpy.random import Generator

from recast.arrays import Array
from recast.logs import HdMap
from recast.synthetic.scenery.primitives import at
from recast.synthetic.streets.ground import Edge, Ground, Island
from recast.synthetic.streets.markings import Markings
from recast.synthetic.streets.network import StreetNetwork
from recast.synthetic.streets.road import Road, Wear, wear_road, wear_turns
from recast.synthetic.streets.shapes import Decals, Pose, placed, without_holes
from recast.synthetic.surface import Surface, concatenate
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
    """A thing that may stand somewhere, with its outlines seen from above in its own frame.

    Attributes:
        surface: surface of the prop, as the scenery functions give it.
        foot: hull of what reaches below the height of a van.
        low: hull of what reaches below the headroom.
        whole: hull of all.
    """

    surface: Surface
    foot: shapely.Geometry
    low: shapely.Geometry
    whole: shapely.Geometry

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
    """Roads of a scene, before anything stands on them.

    Attributes:
        network: roads and lanes.
        route: ids of the ego's lanes.
        speed: m/s of the ego on a free road.
        edge: what lies beside the asphalt.
        fillet: radius of kerbs at corners, metres.
        islands: raised areas.
        wear: wear of the asphalt.
        paved: asphalt besides the roads' and lanes' own.
    """

    network: StreetNetwork
    route: tuple[str, ...]
    speed: float
    edge: Edge
    fillet: float = 7.0
    islands: tuple[Island, ...] = ()
    wear: Wear = field(default_factory=Wear)
    paved: tuple[shapely.Geometry, ...] = ()


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
