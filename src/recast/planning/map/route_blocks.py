"""The blocks that a logged path drives through, in order."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from recast.errors import InputError
from recast.geometry import se2
from recast.planning.map.planner_map import PlannerMap
from recast.planning.route import ReferenceRoute

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


def _beside(centreline: np.ndarray, route: ReferenceRoute, connector: bool) -> _Stretch | None:
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
