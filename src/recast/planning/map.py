"""The map as planners query it: lanes, blocks and areas, and how a log's map becomes one."""

from __future__ import annotations

from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass, replace
from functools import cached_property

import numpy as np
import shapely
from numpy.typing import ArrayLike

from recast.arrays import Array, BoolArray
from recast.core.errors import InputError
from recast.geometry import Polyline, se2
from recast.logs.hdmap import HdMap, Lane
from recast.planning.types import ReferenceRoute


@dataclass(frozen=True)
class PlannerLane:
    """One lane or, inside an intersection, one connector.

    Attributes:
        centreline: (N, 3) x, y, heading in driving direction, at most 0.5 m apart, N >= 2.
        polygon: outline in the plane; a shapely polygon or multi-polygon.
        speed_limit: speed limit in m/s, or None where unknown.
        successors: lanes one can drive on into.
        connector: whether it lies inside an intersection.
    """

    lane_id: str
    block_id: str
    centreline: Array
    polygon: shapely.Geometry
    speed_limit: float | None = None
    successors: tuple[str, ...] = ()
    connector: bool = False

    @cached_property
    def length(self) -> float:
        """Metres along the centreline."""
        steps = np.diff(self.centreline[:, :2], axis=0)
        return float(np.linalg.norm(steps, axis=1).sum())


@dataclass(frozen=True)
class Block:
    """Lanes side by side in one direction: nuPlan's roadblock.

    Attributes:
        connector: whether it lies inside an intersection.
        successors, predecessors: blocks that its lanes lead into and come from.
    """

    block_id: str
    lane_ids: tuple[str, ...]
    connector: bool
    successors: tuple[str, ...] = ()
    predecessors: tuple[str, ...] = ()


@dataclass(frozen=True)
class PlannerMap:
    """What a planner may ask of a map; world frame, metres.

    Attributes:
        lanes: lanes by id, connectors included.
        drivable: further polygons that may be driven on, beside the lanes.
        intersections: polygons, by which a planner knows that it is in one.
        car_parks: polygons, which may be driven on too.
    """

    lanes: Mapping[str, PlannerLane]
    drivable: Sequence[shapely.Geometry] = ()
    intersections: Sequence[shapely.Geometry] = ()
    car_parks: Sequence[shapely.Geometry] = ()

    def __post_init__(self) -> None:
        lanes = [lane.polygon for lane in self.lanes.values()]
        shapely.prepare([*lanes, *self._other, *self.intersections])

    @cached_property
    def blocks(self) -> Mapping[str, Block]:
        """Blocks by id, in the order of their first lanes."""
        members: dict[str, list[str]] = {}
        for lane in self.lanes.values():
            members.setdefault(lane.block_id, []).append(lane.lane_id)
        after: dict[str, dict[str, None]] = {block: {} for block in members}
        before: dict[str, dict[str, None]] = {block: {} for block in members}
        for lane in self.lanes.values():
            for key in lane.successors:
                other = self.lanes[key].block_id
                if other != lane.block_id:
                    after[lane.block_id][other] = None
                    before[other][lane.block_id] = None
        return {
            key: Block(
                key,
                tuple(lanes),
                all(self.lanes[lane].connector for lane in lanes),
                tuple(after[key]),
                tuple(before[key]),
            )
            for key, lanes in members.items()
        }

    def lanes_of(self, blocks: Iterable[str]) -> tuple[str, ...]:
        """Ids of all lanes in some blocks, block by block."""
        return tuple(lane for block in blocks for lane in self.blocks[block].lane_ids)

    def lanes_at(self, point: ArrayLike, reach: float = 0.0) -> tuple[str, ...]:
        """Ids of lanes whose polygon comes within `reach` metres of a point (>=2,), in map order.

        With no reach, those that hold or touch it.
        """
        found = self._lane_tree.query(_point(point), predicate="dwithin", distance=reach)
        return tuple(self._lane_ids[i] for i in np.sort(found))

    def near(self, point: ArrayLike, radius: float) -> PlannerMap:
        """The part of the map whose polygons come within `radius` metres of a point (>=2,)."""
        centre = _point(point)

        def close(polygons: Sequence[shapely.Geometry]) -> tuple[shapely.Geometry, ...]:
            return tuple(p for p in polygons if shapely.dwithin(p, centre, radius))

        kept = {k: v for k, v in self.lanes.items() if shapely.dwithin(v.polygon, centre, radius)}
        reduced = {
            key: replace(lane, successors=tuple(k for k in lane.successors if k in kept))
            for key, lane in kept.items()
        }
        return PlannerMap(
            reduced, close(self.drivable), close(self.intersections), close(self.car_parks)
        )

    def lane_hits(self, points: ArrayLike) -> dict[str, BoolArray]:
        """By lane id, which points (..., 2) lie strictly inside it; lanes without any left out."""
        polygons = [lane.polygon for lane in self.lanes.values()]
        return {
            self._lane_ids[i]: inside
            for i, inside in _hits(polygons, self._lane_tree, np.asarray(points, np.float64))
        }

    def car_park_hits(self, points: ArrayLike) -> list[BoolArray]:
        """For each car park that holds some, which points (..., 2) lie strictly inside it."""
        hits = _hits(self._other, self._other_tree, np.asarray(points, np.float64))
        return [inside for i, inside in hits if i < len(self.car_parks)]

    def drivable_hits(self, points: ArrayLike) -> BoolArray:
        """Which points (..., 2) lie strictly inside a drivable polygon that is no lane.

        Car parks and the drivable area count; intersections do only by the lanes in them.
        """
        points = np.asarray(points, np.float64)
        found = np.zeros(points.shape[:-1], np.bool_)
        for _, inside in _hits(self._other, self._other_tree, points):
            found |= inside
        return found

    def in_intersection(self, points: ArrayLike) -> BoolArray:
        """Which points (..., 2) lie inside an intersection."""
        points = np.asarray(points, np.float64)
        found = np.zeros(points.shape[:-1], np.bool_)
        for polygon in self.intersections:
            found |= np.asarray(shapely.contains_xy(polygon, points[..., 0], points[..., 1]))
        return found

    @cached_property
    def _lane_ids(self) -> tuple[str, ...]:
        return tuple(self.lanes)

    @cached_property
    def _other(self) -> list[shapely.Geometry]:
        return [*self.car_parks, *self.drivable]

    @cached_property
    def _lane_tree(self) -> shapely.STRtree:
        return shapely.STRtree([lane.polygon for lane in self.lanes.values()])

    @cached_property
    def _other_tree(self) -> shapely.STRtree:
        return shapely.STRtree(self._other)


def _hits(
    polygons: Sequence[shapely.Geometry], tree: shapely.STRtree, points: Array
) -> list[tuple[int, BoolArray]]:
    flat = points.reshape(-1, 2)
    bounds = shapely.box(*flat.min(axis=0), *flat.max(axis=0))
    found = []
    for i in np.sort(tree.query(bounds)):
        inside = np.asarray(shapely.contains_xy(polygons[i], points[..., 0], points[..., 1]))
        if inside.any():
            found.append((int(i), inside))
    return found


def _point(point: ArrayLike) -> shapely.Point:
    x, y = np.asarray(point, np.float64)[:2]
    return shapely.Point(x, y)


_SPACING = 0.5
"""Metres between centreline poses at most."""
_DISTANCE = 2.5
_ANGLE = np.pi / 4
_SHARED = 0.5
"""Share of a connector beside the path that must keep to it; of two that overlap by it, one stays.

Connectors that fork off start on the path too, but do not stay there."""


def planner_map(hdmap: HdMap) -> PlannerMap:
    """Lanes with headings, blocks, intersections and drivable area of a log's map.

    Intersections are the unions of touching connector polygons. The log's maps know no car parks.

    Raises:
        InputError: the map has no lanes, or a lane whose centreline or outline is degenerate.
    """
    if not hdmap.lanes:
        raise InputError(
            "map", "lanes", "are missing", "use a log with lanes, or a log in which the ego drives"
        )
    block = group_lanes(hdmap.lanes)
    lanes = {
        key: PlannerLane(
            lane_id=key,
            block_id=block[key],
            centreline=_centreline(key, lane.centreline),
            polygon=_polygon(f"lanes[{key!r}].polygon", lane.polygon),
            speed_limit=lane.speed_limit,
            successors=lane.successors,
            connector=lane.is_intersection,
        )
        for key, lane in hdmap.lanes.items()
    }
    inside = shapely.union_all([lane.polygon for lane in lanes.values() if lane.connector])
    return PlannerMap(
        lanes,
        drivable=[
            _polygon(f"drivable_area[{i}]", outline)
            for i, outline in enumerate(hdmap.drivable_area)
        ],
        intersections=[part for part in shapely.get_parts(inside) if part.area > 0],
    )


def with_headings(points: Array, spacing: float = _SPACING) -> Array:
    """Poses (M, 3) at most `spacing` metres apart along points (N, >=2).

    A vertex gets the mean direction of its two segments; between vertices the heading changes
    linearly, so that coarse curves do not turn in jumps.

    Raises:
        ValueError: fewer than two distinct points.
    """
    line = Polyline.from_points(points)
    steps = np.diff(line.points, axis=0)
    unit = steps / np.linalg.norm(steps, axis=1, keepdims=True)
    at_vertex = np.concatenate([unit[:1], unit[:-1] + unit[1:], unit[-1:]])
    heading = np.unwrap(np.arctan2(at_vertex[:, 1], at_vertex[:, 0]))
    s = np.linspace(0.0, line.length, int(np.ceil(line.length / spacing - 1e-9)) + 1)
    xy = [np.interp(s, line.arc_lengths, line.points[:, k]) for k in range(2)]
    return np.stack([*xy, np.interp(s, line.arc_lengths, heading)], axis=-1)


def _centreline(key: str, points: Array) -> Array:
    try:
        return with_headings(points)
    except ValueError:
        raise InputError(
            "map",
            f"lanes[{key!r}].centreline",
            "has fewer than two distinct points",
            "remove the lane from the map",
        ) from None


def _polygon(field: str, outline: Array) -> shapely.Geometry:
    """The area inside an outline; one that crosses itself is taken apart, not refused."""
    made = shapely.make_valid(shapely.Polygon(outline))
    parts = [p for p in shapely.get_parts(made) if isinstance(p, shapely.Polygon)]
    if not parts:
        raise InputError("map", field, "encloses no area", "remove it from the map")
    return shapely.union_all(parts)


@dataclass(frozen=True)
class _Stretch:
    """Where a block lies beside the path: arc lengths and mean distance, metres."""

    first: float
    last: float
    distance: float


def route_blocks(planner_map: PlannerMap, route: ReferenceRoute) -> tuple[str, ...]:
    """Ids of the blocks driven through: a lane within 2.5 m and 45 degrees of the path.

    Their other lanes, the neighbours, belong to the route with them.

    Raises:
        InputError: no lane lies beside the path.
    """
    found: dict[str, _Stretch] = {}
    for lane in planner_map.lanes.values():
        stretch = _beside(lane.centreline, route, lane.connector)
        if stretch is None:
            continue
        known = found.get(lane.block_id)
        found[lane.block_id] = stretch if known is None else _joined(known, stretch)
    blocks = planner_map.blocks
    kept = [
        key
        for key, stretch in found.items()
        if not blocks[key].connector
        or not any(
            blocks[other].connector and other != key and _replaces(rival, stretch)
            for other, rival in found.items()
        )
    ]
    if not kept:
        x, y = route.line.points[0]
        raise InputError(
            "route",
            "lanes",
            f"no lane of the map lies within {_DISTANCE:g} m of the path from ({x:.1f}, {y:.1f})",
            "use a map that covers the drive, or leave the map out to derive one from the log",
        )
    return tuple(sorted(kept, key=lambda key: found[key].first))


def continued_route(
    planner_map: PlannerMap, blocks: Sequence[str], metres: float
) -> tuple[str, ...]:
    """The route, and where it could go on for at least some metres: straight on if possible.

    A log ends in the middle of a drive. A planner that takes the end of its route for the end of
    the road would brake for it.

    Args:
        blocks: block ids in order, at least one.
        metres: distance beyond the last block; less where the map ends or the route would return.
    """
    route = list(blocks)
    while metres > 0:
        ways = [
            (_turn(lane.centreline), lane)
            for key in planner_map.blocks[route[-1]].lane_ids
            for lane in map(planner_map.lanes.__getitem__, planner_map.lanes[key].successors)
            if lane.block_id not in route
        ]
        if not ways:
            break
        _, straightest = min(ways, key=lambda way: way[0])
        route.append(straightest.block_id)
        metres -= straightest.length
    return tuple(route)


def _turn(centreline: Array) -> float:
    """Radians, not negative, between the first and the last heading."""
    return abs(float(se2.wrap_angle(centreline[-1, 2] - centreline[0, 2])))


def _beside(centreline: Array, route: ReferenceRoute, connector: bool) -> _Stretch | None:
    s, lateral = route.project(centreline)
    beside = (s >= 0.0) & (s <= route.length)
    turn = se2.wrap_angle(centreline[:, 2] - route.heading(s))
    near = beside & (np.abs(lateral) <= _DISTANCE) & (np.abs(turn) <= _ANGLE)
    if not near.any() or (connector and near.sum() < _SHARED * beside.sum()):
        return None
    distance = float(np.abs(lateral[near]).mean())
    return _Stretch(float(s[near].min()), float(s[near].max()), distance)


def _joined(a: _Stretch, b: _Stretch) -> _Stretch:
    return _Stretch(min(a.first, b.first), max(a.last, b.last), min(a.distance, b.distance))


def _replaces(rival: _Stretch, stretch: _Stretch) -> bool:
    """Whether a nearer connector covers the same part of the path."""
    common = min(rival.last, stretch.last) - max(rival.first, stretch.first)
    shorter = min(rival.last - rival.first, stretch.last - stretch.first)
    return rival.distance < stretch.distance and common > _SHARED * shorter


def group_lanes(lanes: Mapping[str, Lane]) -> dict[str, str]:
    """Block id of each lane, by lane id; a block is named after its first lane in map order.

    Outside intersections a block is a connected component of same-direction neighbours. Inside,
    lanes share a block when they come from the same blocks and lead to the same blocks, those at
    the ends of the intersection and those directly before and after, as many lanes into it. A
    connector that is joined to nothing outside is a block of its own.
    """
    block = _neighbour_components(lanes)
    before: dict[str, list[str]] = {key: [] for key in lanes}
    for key, lane in lanes.items():
        for other in lane.successors:
            before[other].append(key)
    after = {key: list(lane.successors) for key, lane in lanes.items()}

    signatures: dict[str, object] = {}
    for key in (key for key, lane in lanes.items() if lane.is_intersection):
        sources, depth = _roads(key, before, lanes, block)
        targets, _ = _roads(key, after, lanes, block)
        signatures[key] = (sources, targets, depth) if sources or targets else key
    grouped = _named(signatures)
    # On a ring every lane comes from and leads to every road: only its direct neighbours tell
    # where on the ring it is.
    while True:
        every = {**block, **grouped}
        finer = _named(
            {
                key: (
                    grouped[key],
                    frozenset(every[other] for other in before[key]),
                    frozenset(every[other] for other in after[key]),
                )
                for key in grouped
            }
        )
        if finer == grouped:
            return every
        grouped = finer


def _named(signatures: Mapping[str, object]) -> dict[str, str]:
    """For each key the first key with the same signature."""
    first: dict[object, str] = {}
    return {key: first.setdefault(signature, key) for key, signature in signatures.items()}


def _neighbour_components(lanes: Mapping[str, Lane]) -> dict[str, str]:
    links: dict[str, set[str]] = {k: set() for k, lane in lanes.items() if not lane.is_intersection}
    for key in links:
        for other in (lanes[key].left_neighbour, lanes[key].right_neighbour):
            # A link that only one side states counts: surveys are not always symmetric.
            if other is not None and other in links:
                links[key].add(other)
                links[other].add(key)
    block: dict[str, str] = {}
    for key in links:
        open_lanes = [key] if key not in block else []
        while open_lanes:
            lane = open_lanes.pop()
            block[lane] = key
            open_lanes += [other for other in links[lane] if other not in block]
    return block


def _roads(
    start: str, links: Mapping[str, list[str]], lanes: Mapping[str, Lane], block: Mapping[str, str]
) -> tuple[frozenset[str], int]:
    """Blocks outside the intersection reached through connectors, and how many connectors away."""
    found: set[str] = set()
    nearest = len(lanes)
    seen, layer, depth = {start}, [start], 0
    while layer:
        reached: list[str] = []
        for lane in layer:
            for other in links[lane]:
                if not lanes[other].is_intersection:
                    found.add(block[other])
                    nearest = min(nearest, depth)
                elif other not in seen:
                    seen.add(other)
                    reached.append(other)
        layer, depth = reached, depth + 1
    return frozenset(found), nearest
