"""The map as lines and triangles in the world."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
import shapely
from numpy.typing import NDArray
from scipy.spatial import cKDTree

from recast.logs import HdMap
from recast.logs.drivable_region import drivable_region

Array = NDArray[np.float64]

_RAISED = 0.06  # metres above the ground, so that splats of the road do not hide lines


def segments(lines: Sequence[Array]) -> Array:
    """Line segments (M, 2, 3) of polylines (N_i, 3), without those that have no length."""
    pairs = [np.stack([line[:-1], line[1:]], axis=1) for line in lines if len(line) > 1]
    joined = np.concatenate(pairs) if pairs else np.zeros((0, 2, 3))
    found: Array = joined[np.any(joined[:, 0] != joined[:, 1], axis=1)]
    return found


def raised(points: Array) -> Array:
    """Points (N, 3), a little higher."""
    return points + np.array([0.0, 0.0, _RAISED])


def lane_lines(hdmap: HdMap) -> tuple[Array, Array]:
    """Segments (M, 2, 3) of the lanes' boundaries and of their centrelines, above the ground."""
    lanes = hdmap.lanes.values()
    boundaries = [
        raised(line)
        for lane in lanes
        if not lane.is_intersection
        for line in (lane.left_boundary, lane.right_boundary)
    ]
    return segments(boundaries), segments([raised(lane.centreline) for lane in lanes])


def drivable_mesh(hdmap: HdMap) -> tuple[Array, NDArray[np.int64]]:
    """Vertices (V, 3) and triangles (F, 3) of the drivable area; none for a map without one."""
    region = drivable_region(hdmap)
    corners: list[Array] = []
    if region is not None and not region.is_empty:
        triangles = shapely.constrained_delaunay_triangles(shapely.simplify(region, 0.1))
        corners = [
            np.asarray(part.exterior.coords)[:3, :2]
            for part in shapely.get_parts(triangles)
            if isinstance(part, shapely.Polygon)
        ]
    if not corners:
        return np.zeros((0, 3)), np.zeros((0, 3), np.int64)
    flat = np.concatenate(corners)
    vertices = raised(np.column_stack([flat, heights(hdmap, flat)]))
    return vertices, np.arange(len(flat)).reshape(-1, 3)


def heights(hdmap: HdMap, points: Array) -> Array:
    """Ground heights (N,) under points (N, 2): of the ground, else of the nearest lane point."""
    found = np.full(len(points), np.nan)
    if hdmap.ground is not None:
        found = hdmap.ground.at(points)
    unknown = np.isnan(found)
    if unknown.any() and hdmap.lanes:
        lines = np.concatenate([lane.centreline for lane in hdmap.lanes.values()])
        _, nearest = cKDTree(lines[:, :2]).query(points[unknown])
        found[unknown] = lines[nearest, 2]
    return np.nan_to_num(found)
