"""The lane graph: roads, the connections through junctions, and roads that meet in a tee."""

from __future__ import annotations

from collections import deque
from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import TYPE_CHECKING, Any, Literal

import numpy as np
import shapely
from numpy.random import Generator

from recast.arrays import Array
from recast.geometry import se2
from recast.logs import Lane
from recast.synthetic.streets.road import Road, Section, make_lane
from recast.synthetic.streets.shapes import Decals, Pose, ReferenceLine, placed
from recast.synthetic.world import ParkingSpot

if TYPE_CHECKING:
    from recast.synthetic.streets.site import Site

_STRAIGHT = np.deg2rad(35)
_TURN_SPEED = 8.0
_SIDE_SPEED = 8.3


@dataclass(frozen=True)
class JunctionArm:
    """A road's end at a junction."""

    road: Road
    at_end: bool  # its forward lanes enter the junction; else its backward lanes do

    def incoming(self) -> list[str]:
        """Ids of lanes that enter the junction, from the middle outwards."""
        return self._lanes(1 if self.at_end else -1)

    def outgoing(self) -> list[str]:
        """Ids of lanes that leave the junction, from the middle outwards."""
        return self._lanes(-1 if self.at_end else 1)

    def _lanes(self, direction: int) -> list[str]:
        section = self.road.section
        count = section.forward if direction > 0 else section.backward
        block = len(self.road.blocks()) - 2 if self.at_end else 0
        return [self.road.lane_id(block, direction * k) for k in range(1, count + 1)]


class StreetNetwork:
    """Collects roads and lanes.

    Attributes:
        roads: roads by name.
        lanes: lanes by id.
    """

    def __init__(self, roads: Sequence[Road]) -> None:
        self.roads = {road.name: road for road in roads}
        self.lanes: dict[str, Lane] = {
            lane.lane_id: lane for road in roads for lane in road.lanes()
        }

    def add(self, lane_id: str, line: ReferenceLine, widths: tuple[float, float]) -> str:
        """Add a lane of a junction along `line`; its width changes evenly between `widths`."""
        s = np.linspace(0.0, line.length, max(int(np.ceil(line.length / 1.0)), 2) + 1)
        half = np.linspace(widths[0], widths[1], len(s)) / 2
        self.lanes[lane_id] = make_lane(
            lane_id,
            line.offset(s, np.zeros_like(s)),
            line.offset(s, half),
            line.offset(s, -half),
            _TURN_SPEED,
            is_intersection=True,
        )
        return lane_id

    def follow(self, lane_id: str, *successors: str) -> None:
        """Let `successors` be driven on into from a lane."""
        lane = self.lanes[lane_id]
        self.lanes[lane_id] = replace(lane, successors=(*lane.successors, *successors))

    def connect(self, lane_id: str, source: str, target: str, reach: float = np.inf) -> str:
        """Add a lane from the end of one to the start of another."""
        first, last = self.lanes[source], self.lanes[target]
        line = ReferenceLine.between(end_pose(first), start_pose(last), reach)
        self.add(lane_id, line, (_width(first, -1), _width(last, 0)))
        # The ends are those of the lanes joined, to the last digit.
        joined = self.lanes[lane_id]
        lines = []
        for name in ("centreline", "left_boundary", "right_boundary"):
            points = getattr(joined, name).copy()
            points[0], points[-1] = getattr(first, name)[-1], getattr(last, name)[0]
            lines.append(points[:, :2])
        middle, left, right = lines
        self.lanes[lane_id] = make_lane(
            lane_id, middle, left, right, _TURN_SPEED, (target,), is_intersection=True
        )
        self.follow(source, lane_id)
        return lane_id

    def junction(
        self,
        name: str,
        arms: Sequence[JunctionArm],
        right_reach: float,
        barred: Sequence[tuple[str, str]] = (),
    ) -> None:
        """Connect all arms: straight on lane by lane, left from the inner, right from the outer.

        Args:
            name: first part of the ids of its lanes.
            arms: the roads' ends.
            right_reach: metres before the corner at which right turns begin.
            barred: names of roads (from, to) between which one cannot turn.
        """
        for arm in arms:
            for other in arms:
                if (arm.road.name, other.road.name) in barred:
                    continue
                if other is arm or not arm.incoming() or not other.outgoing():
                    continue
                self._movement(name, arm, other, right_reach)

    def _movement(
        self, name: str, arm: JunctionArm, other: JunctionArm, right_reach: float
    ) -> None:
        sources, targets = arm.incoming(), other.outgoing()
        leaving, entering = self.lanes[sources[0]], self.lanes[targets[0]]
        turn = float(se2.wrap_angle(start_pose(entering).heading - end_pose(leaving).heading))
        stem = f"{name}-{arm.road.name}-{other.road.name}"
        if abs(turn) < _STRAIGHT:
            made = [
                self.connect(f"{stem}-{k + 1}", source, target)
                for k, (source, target) in enumerate(zip(sources, targets, strict=False))
            ]
            for k, lane_id in enumerate(made):
                self.lanes[lane_id] = replace(
                    self.lanes[lane_id],
                    speed_limit=leaving.speed_limit,
                    left_neighbour=made[k - 1] if k > 0 else None,
                    right_neighbour=made[k + 1] if k + 1 < len(made) else None,
                )
        elif turn > 0:
            self.connect(f"{stem}-left", sources[0], targets[0])
        else:
            self.connect(f"{stem}-right", sources[-1], targets[-1], right_reach)

    def route(self, start: str, goal: str) -> tuple[str, ...]:
        """Ids of the lanes from start to goal, the fewest. Raises ValueError: the goal cannot be
        reached."""
        chains: deque[tuple[str, ...]] = deque([(start,)])
        met = {start}
        while chains:
            chain = chains.popleft()
            if chain[-1] == goal:
                return chain
            ahead = [name for name in self.lanes[chain[-1]].successors if name not in met]
            met.update(ahead)
            chains.extend((*chain, name) for name in ahead)
        raise ValueError(f"no way from lane {start!r} to {goal!r}")


def start_pose(lane: Lane) -> Pose:
    """Where a lane begins; the heading is square to the line between its boundaries' ends."""
    return _end(lane, 0)


def end_pose(lane: Lane) -> Pose:
    """Where a lane ends; the heading is square to the line between its boundaries' ends."""
    return _end(lane, -1)


def _end(lane: Lane, k: int) -> Pose:
    across = lane.left_boundary[k] - lane.right_boundary[k]
    heading = float(np.arctan2(-across[0], across[1]))
    return Pose(float(lane.centreline[k, 0]), float(lane.centreline[k, 1]), heading)


def _width(lane: Lane, k: int) -> float:
    return float(np.linalg.norm(lane.left_boundary[k] - lane.right_boundary[k]))


@dataclass(frozen=True)
class Tee:
    """A road, and one that joins it from the side."""

    network: StreetNetwork  # roads and lanes
    # main, ahead: the through road before and after the junction, on one line.
    main: Road
    ahead: Road
    side: Road  # road that leads away from the junction

    def route(self, index: int) -> tuple[str, ...]:
        """Straight through, on lane `index` (1 is the innermost)."""
        last = len(self.ahead.blocks()) - 2
        return self.network.route(self.main.lane_id(0, index), self.ahead.lane_id(last, index))


def tee(
    line: ReferenceLine,
    section: Section,
    minor: Section,
    crossing: float,
    way: int,
    speed: float,
    fillet: float,
    zebra: bool = True,
    barred: Sequence[tuple[str, str]] = (),
    side_length: float = 90.0,
) -> Tee:
    """A side road at arc length `crossing` of a through road.

    Args:
        line: reference line of the through road.
        section: section of the through road.
        minor: section of the side road.
        crossing: arc length of the side road's middle.
        way: +1 joins from the left, -1 from the right.
        speed: limit on the through road, m/s.
        fillet: radius of the kerbs at the corners.
        zebra: leave room for a crossing before the junction.
        barred: names of roads (from, to) between which one cannot turn, as in
            `StreetNetwork.junction`.
        side_length: metres of the side road.
    """
    half = minor.kerb(1) + fillet + (5.0 if zebra else 0.5)
    main = Road("main", line, section, 0.0, crossing - half, speed, (0.0, crossing))
    total = line.length
    ahead = Road("ahead", line, section, crossing + half, total, speed, (crossing, total))
    here = line.pose(crossing)
    across = here._replace(heading=here.heading + way * np.pi / 2)
    side_line = ReferenceLine.straight(across, side_length)
    kerb = abs(section.kerb(way))
    begin = kerb - 3.0 if section.median > 0.5 else 0.0
    start = kerb + fillet + 0.5
    side = Road("side", side_line, minor, start, side_length, _SIDE_SPEED, (begin, side_length))
    network = StreetNetwork([main, ahead, side])
    arms = [JunctionArm(main, True), JunctionArm(ahead, False), JunctionArm(side, False)]
    network.junction("crossing", arms, fillet + 3.0, barred)
    return Tee(network, main, ahead, side)


ArrowKind = Literal["straight", "left", "right", "straight-left", "straight-right"]

HEIGHT = 0.004
WHITE = np.array([0.62, 0.62, 0.60])
YELLOW = np.array([0.62, 0.44, 0.06])

_HEAD = [(4.0, 0.0), (2.6, 0.42), (2.6, -0.42)]
_STEM = [(0.0, 0.075), (0.0, -0.075), (2.65, -0.075), (2.65, 0.075)]
_HOOK_STEM = [(0.0, 0.075), (0.0, -0.075), (1.9, -0.075), (2.6, 0.45), (2.4, 0.6), (1.7, 0.075)]
_HOOK_HEAD = [(3.05, 1.0), (2.15, 0.85), (2.85, 0.2)]
CentreLine = Literal["dashed", "solid", "double", "none"]
Control = Literal["stop", "yield", "none"]


class Markings:
    """Paints onto roads.

    Attributes:
        decals: decals that the shapes are added to.
        rng: random generator of how worn each piece of paint is.
    """

    def __init__(self, decals: Decals, rng: Generator) -> None:
        self.decals = decals
        self.rng = rng
        self._wear = rng.uniform(0.75, 1.0)

    def line(
        self,
        road: Road,
        start: float,
        end: float,
        lateral: float,
        width: float = 0.12,
        colour: Array = WHITE,
        side: int | None = None,
    ) -> None:
        """A solid line along the road."""
        if end - start < 0.3:
            return
        s = road.stations(start, end)
        left, right = (
            road.point(s, lateral + half, side if side is not None else int(np.sign(lateral)))
            for half in (width / 2, -width / 2)
        )
        self.decals.strip(left, right, HEIGHT, self._paint(colour, len(s) - 1), "marking")

    def dashes(
        self,
        road: Road,
        start: float,
        end: float,
        lateral: float,
        dash: float = 3.0,
        gap: float = 6.0,
        width: float = 0.12,
        colour: Array = WHITE,
        side: int | None = None,
    ) -> None:
        """A broken line along the road."""
        for s in np.arange(start, end - dash / 2, dash + gap):
            self.line(road, s, min(s + dash, end), lateral, width, colour, side)

    def across(
        self, road: Road, s: float, near: float, far: float, width: float = 0.4, side: int = 0
    ) -> None:
        """A stop line at s between two laterals."""
        self._box(road, s - width / 2, s + width / 2, near, far, side)

    def zebra(self, road: Road, s: float, length: float = 3.5, bar: float = 0.5) -> None:
        """A crossing from kerb to kerb, its bars along the traffic; s is its middle."""
        left, right = road.section.kerb(1) - 0.3, road.section.kerb(-1) + 0.3
        count = int((left - right - bar) / (2 * bar)) + 1
        first = (left + right) / 2 - (count - 1) * bar
        island = float(road.apart(s)) > 0.5 or road.section.median > 1.0
        for k in range(count):
            middle = first + 2 * bar * k
            if island and abs(middle) < road.section.median / 2 + 0.4:
                continue
            self._box(road, s - length / 2, s + length / 2, middle - bar / 2, middle + bar / 2)

    def teeth(self, road: Road, s: float, near: float, far: float, towards: int, side: int) -> None:
        """A row of give-way triangles at s that point at traffic driving `towards` (+1, -1)."""
        low, high = sorted((near, far))
        count = max(int((high - low) / 0.75), 1)
        middles = low + (np.arange(count) + 0.5) * (high - low) / count
        for middle in middles:
            laterals = [middle - 0.25, middle + 0.25, middle]
            corners = road.point([s, s, s - towards * 0.6], laterals, side)
            self.decals.add(corners, HEIGHT, self._paint(WHITE, 1), "marking")

    def arrow(self, pose: Pose, kind: ArrowKind) -> None:
        """An arrow, 4 m long, that begins at the pose and shows where to drive on."""
        shapes = []
        if kind != "left" and kind != "right":
            shapes += [_STEM, _HEAD]
        for way, sign in (("left", 1.0), ("right", -1.0)):
            if kind.endswith(way):
                shapes += [
                    [(x, sign * y) for x, y in points] for points in (_HOOK_STEM, _HOOK_HEAD)
                ]
        whole = shapely.union_all([shapely.Polygon(points) for points in shapes])
        self.decals.polygon(placed(whole, pose), HEIGHT, self._paint(WHITE, 1)[0], "marking")

    def _box(
        self, road: Road, start: float, end: float, near: float, far: float, side: int | None = None
    ) -> None:
        low, high = sorted((near, far))
        left, right = (road.point([start, end], lateral, side) for lateral in (high, low))
        self.decals.strip(left, right, HEIGHT, self._paint(WHITE, 1), "marking")

    def _paint(self, colour: Array, count: int) -> Array:
        return colour * self._wear * self.rng.uniform(0.86, 1.0, (count, 1))


@dataclass(frozen=True)
class RoadPaint:
    """Lines of a road."""

    centre: CentreLine = "dashed"  # kind of the centre line, between the directions
    edges: bool = True  # solid lines along the outer edges of the lanes
    yellow: bool = False  # the centre line is yellow
    solid: float = 22.0  # metres before `start` and `end` arms in which dividers are not broken
    # dash, gap: lengths in metres of the dashes and gaps of broken lines.
    dash: float = 3.0
    gap: float = 6.0
    bays: bool = True  # ticks between parking spots


def paint_road(site: Site, road: Road, paint: RoadPaint, solid_ends: tuple[bool, bool]) -> None:
    """Lines along a road; `solid_ends` tells at which ends (start, end) traffic must keep lane."""
    section, marks = road.section, site.markings
    start, end = road.start, road.end
    if not solid_ends[0]:
        start = road.paved[0]
    if not solid_ends[1]:
        end = road.paved[1]
    free = (start + paint.solid * solid_ends[0], end - paint.solid * solid_ends[1])
    colour = YELLOW if paint.yellow else WHITE

    def broken(lateral: float, **options: Any) -> None:
        marks.dashes(road, *free, lateral, paint.dash, paint.gap, **options)
        for a, b in ((start, free[0]), (free[1], end)):
            marks.line(road, a, b, lateral, **options)

    if section.median > 0.5:
        for side in (1, -1):
            marks.line(road, start, end, side * (section.median / 2 + 0.02), colour=colour)
    centre = "none" if section.median > 0.5 or road.spread else paint.centre
    if centre == "double" or centre == "solid":
        for lateral in (0.11, -0.11) if centre == "double" else (0.0,):
            marks.line(road, start, end, lateral, colour=colour, side=0)
    elif centre == "dashed":
        broken(0.0, colour=colour)
    for side, count in ((1, section.backward), (-1, section.forward)):
        for k in range(1, count):
            broken(side * (section.median / 2 + k * section.lane_width), side=side)
        if paint.edges:
            lateral = section.lanes_edge(side) + side * 0.02
            marks.line(road, start, end, lateral, 0.14, side=side)


def paint_through(site: Site, before: Road, after: Road) -> None:
    """Broken dividers between the lanes of a through road across a junction."""
    section = before.section
    for side, count in ((1, section.backward), (-1, section.forward)):
        for k in range(1, count):
            lateral = side * (section.median / 2 + k * section.lane_width)
            site.markings.dashes(before, before.end + 3, after.start, lateral, 1.5, 3.0)
        if section.median > 0.5:
            lateral = side * (section.median / 2 + 0.02)
            site.markings.line(before, before.end, after.start, lateral)


def paint_arm(
    site: Site,
    arm: JunctionArm,
    control: Control,
    zebra: bool,
    arrows: Sequence[ArrowKind] = (),
) -> None:
    """Stop or give-way line, crossing and arrows where a road meets a junction.

    Args:
        arm: the road's end.
        control: line across the incoming lanes.
        zebra: a pedestrian crossing beyond the line.
        arrows: arrows of the incoming lanes, from the middle outwards.
    """
    road, section, marks = arm.road, arm.road.section, site.markings
    towards = 1 if arm.at_end else -1
    s = road.end if arm.at_end else road.start
    side = -towards
    near = side * (section.median / 2 + 0.15)
    far = section.lanes_edge(side) - side * 0.05
    if control == "stop":
        marks.across(road, s - towards * 0.3, near, far, side=side)
    elif control == "yield":
        marks.teeth(road, s - towards * 0.2, near, far, towards, side)
    if zebra:
        marks.zebra(road, s + towards * 2.8)
    for k, kind in enumerate(arrows):
        inner, outer = section.lane(towards * (k + 1))
        for back in (9.0, 26.0):
            at = s - towards * back
            pose = road.pose(at, (inner + outer) / 2, reverse=towards < 0)
            marks.arrow(pose, kind)


def bays(start: float, end: float, pitch: float, block: int) -> tuple[list[float], list[float]]:
    """Middles of parking places along a road, and of those left out: each after `block` places."""
    middles = np.arange(start, end - pitch, pitch) + pitch / 2
    out = [k % (block + 1) == block for k in range(len(middles))]
    kept = [float(s) for s, skip in zip(middles, out, strict=True) if not skip]
    return kept, [float(s) for s, skip in zip(middles, out, strict=True) if skip]


def park_along(
    site: Site,
    road: Road,
    side: int,
    middles: Sequence[float],
    share: float = 1.0,
    pitch: float = 6.1,
    length: float = 5.4,
    ticks: bool = True,
) -> None:
    """Parking spots in the parking lane of a road.

    Args:
        road: road with a parking lane on that side.
        side: +1 left, -1 right.
        middles: arc lengths of places, see `bays`.
        share: share of the places that are spots.
        pitch: metres from one place to the next.
        length: metres that a vehicle may have.
        ticks: painted between places.
    """
    section = road.section
    depth = section.parking_left if side > 0 else section.parking_right
    middle = section.lanes_edge(side) + side * (depth / 2 + 0.12)
    for s in middles:
        if site.rng.random() < share:
            pose = road.pose(s, middle, reverse=side > 0)
            site.parking.append(ParkingSpot(pose.x, pose.y, float(pose.heading), length))
        if ticks:
            inner = section.lanes_edge(side) + side * 0.15
            for at in (s - pitch / 2, s + pitch / 2):
                site.markings.across(road, at, inner, section.kerb(side), width=0.1, side=side)
