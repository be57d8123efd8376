"""The blocks that a logged path drives through, in order."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from recast.errors import InputError
from recast.geometry import se2
from recast.planning.map.planner_map import PlannerMap
from recast.planning.route import ReferenceRoute

Array = NDArray[np.float64]

_DISTANCE = 2.5
_ANGLE = np.pi / 4
_SHARED = 0.5
"""Share of a connector beside the path that must keep to it; of two that overlap by it, one stays.

Connectors that fork off start on the path too, but do not stay there."""


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
            "use a map that covers the drive, or let one be derived from the log",
        )
    return tuple(sorted(kept, key=lambda key: found[key].first))


def continued_route(
    planner_map: PlannerMap, blocks: Sequence[str], metres: float
) -> tuple[str, ...]:
    """The route, and where it could go on for at least some metres: straight on if possible.

    A log ends in the middle of a drive. A planner that takes the end of its route for the end of
    the road would brake for it.

    Args:
        blocks: ids in order, at least one.
        metres: beyond the last block; fewer where the map ends or the route would return.
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
