"""The adapter from a log's map to the planners' one."""

from __future__ import annotations

import numpy as np
import shapely
from numpy.typing import NDArray

from recast.errors import InputError
from recast.geometry import Polyline
from recast.logs.hdmap import HdMap
from recast.planning.map.blocks import group_lanes
from recast.planning.map.planner_map import PlannerLane, PlannerMap

Array = NDArray[np.float64]

_SPACING = 0.5
"""Metres between centreline poses at most."""


def planner_map(hdmap: HdMap) -> PlannerMap:
    """Lanes with headings, blocks, intersections and drivable area of a log's map.

    Intersections are the unions of touching connector polygons. The log's maps know no car parks.

    Raises:
        InputError: the map has no lanes, or a lane whose centreline or outline is degenerate.
    """
    if not hdmap.lanes:
        raise InputError(
            "map", "lanes", "there are none", "use a log with a lane map, or one that drives"
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
