"""A street under construction: layout first, then ground, then what stands beside."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, field

import numpy as np
import shapely
from numpy.random import Generator
from numpy.typing import NDArray

from recast.logs import HdMap
from recast.synthetic.streets.daylight import daylight
from recast.synthetic.streets.ground import Edge, Ground, Island
from recast.synthetic.streets.markings import Markings
from recast.synthetic.streets.network import Network
from recast.synthetic.streets.placement import Placer, Prop
from recast.synthetic.streets.reference_line import Pose
from recast.synthetic.streets.road import Road
from recast.synthetic.streets.triangles import Decals, without_holes
from recast.synthetic.streets.wear import Wear, wear_road, wear_turns
from recast.synthetic.surface import Surface, concatenate
from recast.synthetic.world import ParkingSpot, Street

Array = NDArray[np.float64]

EGO_START = 80.0
"""Metres of `ego_route` before the place from which the ego drives `length` metres."""
RUN_OUT = 200.0
"""Metres of `ego_route` after that."""


@dataclass(frozen=True)
class Layout:
    """Roads of a scene, before anything stands on them.

    Attributes:
        network: roads and lanes.
        route: ids of the ego's lanes.
        speed: m/s of the ego on a free road.
        edge: what lies beside the asphalt.
        fillet: radius of kerbs at corners, metres.
        islands: raised areas.
        wear: of the asphalt.
        paved: asphalt besides the roads' and lanes' own.
    """

    network: Network
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
        placer: of props.
        decals: thin shapes on the ground.
        public: asphalt, verges and pavements.
        core: of `public`, what awnings and steps of buildings do not reach into.
        parking: spots for parked cars.
        extras: further surfaces in the world frame.
    """

    def __init__(self, layout: Layout, rng: Generator) -> None:
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
        chance: float = 1.0,
    ) -> None:
        """Props along a road.

        Args:
            road: the road.
            side: +1 left, -1 right.
            props: one is drawn for each place.
            spacing: metres between them.
            away: metres outside the kerb.
            start, end: arc lengths; the road's by default.
            jitter: metres by which places vary along the road, a third of it across.
            turn: radians added to the heading; None for any.
            off_pavement: keep clear of the pavement and verges too.
            overlap: as in `Placer.place`.
            chance: that there is one at each place.
        """
        begin = (road.start if start is None else start) + self.rng.uniform(0.2, 0.8) * spacing
        for s in np.arange(begin, road.end if end is None else end, spacing):
            place = float(s) + self.rng.uniform(-jitter, jitter)
            out = away + self.rng.uniform(-jitter, jitter) / 3
            prop = props[int(self.rng.integers(len(props)))]
            angle = self.rng.uniform(0, 2 * np.pi) if turn is None else turn
            if self.rng.random() > chance:
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
                [shapely.Polygon(lane.polygon) for lane in network.lanes.values()
                 if not lane.is_intersection]
            )  # fmt: skip
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
