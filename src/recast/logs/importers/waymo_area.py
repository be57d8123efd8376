"""The drivable area of a Waymo map, which stores none: lanes, and the road up to its edges."""

from __future__ import annotations

from collections.abc import Iterator, Sequence

import numpy as np
import shapely

from recast.logs.types import Array

REACH = 5.0
"""Metres from a lane's side within which a road edge still bounds the same road: a shoulder, or
parking and bicycle lane."""
_SEAM = 0.3
"""Metres: narrower gaps between lanes are seams of their outlines."""
_SMALLEST = 1.0
"""Square metres of an outline that is kept."""


def drivable_area(
    ribbons: Sequence[tuple[Array, Array]], edges: Sequence[Array], driveways: Sequence[Array]
) -> tuple[Array, ...]:
    """Outlines (N, 2) of where one can drive, without holes.

    The union of all lanes and driveways, of the strips between a lane's side and the road edge
    beside it, and of the gaps enclosed by these in which no road edge lies, such as the middle of
    an intersection.

    Args:
        ribbons: left and right boundary (N, 3) of each lane, point beside point.
        edges: road edges (N, 3).
        driveways: outlines (N, 2).
    """
    lines = [shapely.LineString(edge[:, :2]) for edge in edges if len(edge) >= 2]
    parts: list[shapely.Geometry] = []
    for left, right in ribbons:
        parts += _between(left[:, :2], right[:, :2])
        parts += _shoulder(left[:, :2], right[:, :2], lines)
        parts += _shoulder(right[:, :2], left[:, :2], lines)
    parts += [shapely.Polygon(outline) for outline in driveways if len(outline) >= 3]
    area = shapely.union_all([shapely.make_valid(part) for part in parts])
    area = area.buffer(_SEAM, join_style="mitre").buffer(-_SEAM, join_style="mitre")
    kerbs = shapely.union_all(lines)
    outlines = []
    for polygon in _polygons(area):
        islands = [hole for hole in polygon.interiors if shapely.Polygon(hole).intersects(kerbs)]
        filled = shapely.Polygon(polygon.exterior, islands)
        outlines += [
            shapely.get_coordinates(piece.exterior)[:-1]
            for piece in _without_holes(filled)
            if piece.area >= _SMALLEST
        ]
    return tuple(outlines)


def _between(first: Array, second: Array) -> list[shapely.Polygon]:
    """What lies between two lines (N >= 2, 2), point beside point."""
    whole = shapely.Polygon(np.concatenate([first, second[::-1]]))
    if whole.is_valid:
        return [whole]
    # A sharp inner bend folds a ribbon over itself; the quadrangles between its points stay simple.
    corners = np.stack([first[:-1], first[1:], second[1:], second[:-1]], axis=1)
    return list(shapely.polygons(corners))


def _shoulder(side: Array, other: Array, edges: list[shapely.LineString]) -> list[shapely.Polygon]:
    """Between a lane's side (N, 2) and the first road edge beyond it, seen from the other side."""
    outwards = side - other
    outwards /= np.maximum(np.linalg.norm(outwards, axis=1, keepdims=True), 1e-9)
    rays = shapely.linestrings(np.stack([side, side + REACH * outwards], axis=1))
    tree = shapely.STRtree(edges)
    ray, edge = tree.query(rays, predicate="intersects")
    hits = shapely.intersection(rays[ray], np.array(edges, object)[edge])
    width = np.full(len(side), np.inf)
    np.minimum.at(width, ray, shapely.distance(shapely.points(side)[ray], hits))
    reached = np.isfinite(width)
    beyond = side + np.where(reached, width, 0.0)[:, None] * outwards
    runs = np.split(np.arange(len(side)), np.flatnonzero(np.diff(reached)) + 1)
    return [
        part
        for run in runs
        if reached[run[0]] and len(run) >= 2
        for part in _between(side[run], beyond[run])
    ]


def _polygons(area: shapely.Geometry) -> list[shapely.Polygon]:
    return [part for part in shapely.get_parts(area) if part.geom_type == "Polygon"]


def _without_holes(polygon: shapely.Polygon) -> Iterator[shapely.Polygon]:
    """Cut a polygon through its holes, from top to bottom, until none is left."""
    if not polygon.interiors:
        yield polygon
        return
    x = shapely.Polygon(polygon.interiors[0]).representative_point().x
    left, bottom, right, top = polygon.bounds
    for half in (shapely.box(left, bottom, x, top), shapely.box(x, bottom, right, top)):
        for piece in _polygons(shapely.intersection(polygon, half)):
            yield from _without_holes(piece)
