"""The planners' map from a log: lanes and their blocks, and the blocks of the logged route."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass

import numpy as np
import shapely

from recast.arrays import Array
from recast.core.errors import InputError
from recast.geometry import Polyline, se2
from recast.logs.hdmap import HdMap, Lane
from recast.planning.map import PlannerLane, PlannerMap
from recast.planning.route import ReferenceRoute

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
