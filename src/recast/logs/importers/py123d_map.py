"""The map of a py123d scene: lanes for cars and drivable area around the drive."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np
import shapely
from scipy.spatial import cKDTree

from recast.errors import InputError
from recast.logs.hdmap import HdMap, Lane
from recast.logs.importers.map_place import NEAR, metres_beside
from recast.logs.types import Array

REACH = 150.0
"""Metres around the drive: some maps are of a whole city."""
NOT_FOR_CARS = ("BIKE_LANE",)
AREAS = ("lane", "lane_group", "intersection", "generic_drivable", "carpark")
"""Layers whose surfaces one can drive on."""


def read_map(api: Any, folder: Path, ego: Array, offset: Array) -> HdMap | None:
    """The map in the world frame, or None where the log has none or one without lanes.

    Args:
        api: a `py123d.api.MapAPI`, or None.
        folder: for messages.
        ego: (T, 3) places of the ego in the world.
        offset: (3,) py123d's global coordinates = world coordinates + this.

    Raises:
        InputError: the map lies elsewhere than the drive.
    """
    if api is None:
        return None
    near = shapely.LineString((ego + offset)[:, :2]).buffer(REACH)
    layers = {layer.name.lower() for layer in api.get_available_map_layers()}
    surfaces = {
        layer: [
            surface
            for found in api.query(near, [layer], "intersects").values()
            for surface in found
        ]
        for layer in AREAS
        if layer in layers
    }
    driven = [lane for lane in surfaces.get("lane", []) if lane.lane_type.name not in NOT_FOR_CARS]
    if not driven:
        return None
    known = {str(lane.object_id) for lane in driven}
    crossing = {
        str(key)
        for group in surfaces.get("lane_group", [])
        if group.intersection_id is not None
        for key in group.lane_ids
    }
    heights = None if api.map_has_z else ego
    lanes = {str(lane.object_id): _lane(lane, known, crossing, offset, heights) for lane in driven}
    distance = metres_beside(lanes, ego[:, :2])
    if distance > NEAR:
        problem = f"the ego drives {distance:.0f} m beside all lanes: not the map of this drive"
        raise InputError(folder, "map", problem, "convert the log again")
    areas = tuple(
        np.asarray(surface.shapely_polygon.exterior.coords)[:-1, :2] - offset[:2]
        for found in surfaces.values()
        for surface in found
    )
    return HdMap(lanes=lanes, drivable_area=areas, notes={"source": "py123d"})


def _lane(
    lane: Any, known: set[str], crossing: set[str], offset: Array, heights: Array | None
) -> Lane:
    """`heights` are places (T, 3) that give a flat map its heights: those of the nearest."""

    def line(name: str) -> Array:
        points = np.asarray(getattr(lane, f"{name}_3d").array, np.float64) - offset
        if heights is not None:
            points[:, 2] = heights[cKDTree(heights[:, :2]).query(points[:, :2])[1], 2]
        return points

    def named(key: Any) -> str | None:
        return str(key) if key is not None and str(key) in known else None

    left, right, limit = line("left_boundary"), line("right_boundary"), lane.speed_limit_mps
    outline = shapely.Polygon(np.concatenate([right[:, :2], left[::-1, :2]]))
    return Lane(
        lane_id=str(lane.object_id),
        centreline=line("centerline"),
        left_boundary=left,
        right_boundary=right,
        polygon=shapely.get_coordinates(shapely.orient_polygons(outline).exterior)[:-1],
        speed_limit=float(limit) if limit else None,
        successors=tuple(str(key) for key in lane.successor_ids if str(key) in known),
        left_neighbour=named(lane.left_lane_id),
        right_neighbour=named(lane.right_lane_id),
        is_intersection=str(lane.object_id) in crossing,
    )
