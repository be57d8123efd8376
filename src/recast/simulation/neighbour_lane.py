"""Where the next lane of the same direction lies: by the map or by who drove there."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from recast.geometry import se2
from recast.logs.hdmap import HdMap
from recast.logs.types import DrivingLog, Track
from recast.planning import ReferenceRoute, route_lanes

Array = NDArray[np.float64]

_LANE_OFFSETS = (2.5, 4.5)
"""Metres beside the route at which a vehicle drives in the next lane."""
_SAME_DIRECTION = np.deg2rad(15)
_MOVING = 2.0
_MIN_POSES = 10


def neighbour_lateral(
    log: DrivingLog, hdmap: HdMap | None, route: ReferenceRoute, s: float
) -> float | None:
    """Offset in metres, left positive, of the next lane of the same direction.

    By a surveyed map: the neighbour of the lane at route coordinate `s`, the left one first. Else
    by the recorded traffic, which shows where lanes are better than a derived map does: the median
    offset of vehicles that drove beside the route in its direction, on the side where more were
    seen. Else by the derived map. None where nothing tells.
    """
    mapped = None if hdmap is None else _by_map(hdmap, route, s)
    if hdmap is not None and not hdmap.derived and mapped is not None:
        return mapped
    driven = _by_traffic(log, route)
    return mapped if driven is None else driven


def _by_traffic(log: DrivingLog, route: ReferenceRoute) -> float | None:
    offsets = np.concatenate(
        [np.zeros(0), *(_driven_beside(track, route) for track in log.tracks.values())]
    )
    left, right = offsets[offsets > 0], offsets[offsets < 0]
    side = left if len(left) >= len(right) else right
    return float(np.median(side)) if len(side) >= _MIN_POSES else None


def _by_map(hdmap: HdMap, route: ReferenceRoute, s: float) -> float | None:
    for lane in route_lanes(hdmap, route):
        along, _ = route.project(lane.centreline)
        if not along.min() <= s <= along.max():
            continue
        for neighbour in (lane.left_neighbour, lane.right_neighbour):
            if neighbour is None:
                continue
            beside, lateral = route.project(hdmap.lanes[neighbour].centreline)
            if beside.min() <= s <= beside.max():  # a neighbour may begin further on
                return float(lateral[np.argmin(np.abs(beside - s))])
    return None


def _driven_beside(track: Track, route: ReferenceRoute) -> Array:
    """Offsets of a track's poses in the next lane, moving in the route's direction."""
    times = track.trajectory.timestamps_us * 1e-6
    if len(times) < 2:
        return np.zeros(0)
    poses = se2.from_se3(track.trajectory.poses)
    s, lateral = route.project(poses)
    speed = np.gradient(s, times)
    turn = np.abs(se2.wrap_angle(poses[:, 2] - route.heading(s)))
    near, far = _LANE_OFFSETS
    beside = (np.abs(lateral) >= near) & (np.abs(lateral) <= far)
    beside &= (speed >= _MOVING) & (turn <= _SAME_DIRECTION) & (s >= 0) & (s <= route.length)
    return lateral[beside]
