"""From outlines in the plane to triangles."""

from __future__ import annotations

from collections.abc import Callable

import numpy as np
import shapely
from numpy.typing import ArrayLike, NDArray

from recast.synthetic.materials import MATERIAL_INDEX
from recast.synthetic.scenery.primitives import quads
from recast.synthetic.surface import Surface

Array = NDArray[np.float64]


def triangulate(region: shapely.Geometry) -> Array:
    """Triangles (T, 3, 2), counter-clockwise, that fill polygons with holes."""
    parts = [part for part in shapely.get_parts(region) if part.geom_type == "Polygon"]
    triangles = [
        shapely.get_coordinates(shapely.constrained_delaunay_triangles(part)).reshape(-1, 4, 2)
        for part in parts
        if part.area > 1e-6
    ]
    if not triangles:
        return np.zeros((0, 3, 2))
    corners = np.concatenate(triangles)[:, :3]
    a, b = corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0]
    clockwise = a[:, 0] * b[:, 1] - a[:, 1] * b[:, 0] < 0
    corners[clockwise] = corners[clockwise][:, ::-1]
    return corners


def without_holes(region: shapely.Geometry) -> list[shapely.Polygon]:
    """Polygons without holes that together cover a region: cut through the middle of each hole."""
    done, left = [], [part for part in shapely.get_parts(region) if part.geom_type == "Polygon"]
    while left:
        part = left.pop()
        if len(part.interiors) == 0:
            done.append(part)
            continue
        low_x, low_y, high_x, high_y = part.bounds
        middle = shapely.Polygon(part.interiors[0]).centroid.x
        for box in (
            shapely.box(low_x - 1, low_y - 1, middle, high_y + 1),
            shapely.box(middle, low_y - 1, high_x + 1, high_y + 1),
        ):
            cut = shapely.get_parts(part.intersection(box))
            left += [piece for piece in cut if piece.geom_type == "Polygon" and piece.area > 1e-6]
    return done


def soup(corners: ArrayLike, colour: ArrayLike, material: str) -> Surface:
    """Separate flat triangles (T, 3, 3), with colour (3,) or (T, 3)."""
    corners = np.asarray(corners, np.float64).reshape(-1, 3, 3)
    faces = np.arange(3 * len(corners)).reshape(-1, 3)
    return Surface.make(corners.reshape(-1, 3), faces, colour, material, crease=0.0)


def flat(
    region: shapely.Geometry,
    height: float | Callable[[Array], Array],
    colour: ArrayLike,
    material: str,
) -> Surface:
    """A region seen from above, at a height or at heights given by place (N, 2) -> (N,)."""
    corners = triangulate(region)
    xy = corners.reshape(-1, 2)
    z = height(xy) if callable(height) else np.full(len(xy), height)
    return soup(np.concatenate([xy, z[:, None]], axis=1), colour, material)


def ribbon(left: Array, right: Array, colour: ArrayLike, material: str) -> Surface:
    """A strip between two lines (N, 3); seen from above when left is to the left."""
    return quads(np.stack([right[:-1], right[1:], left[1:], left[:-1]], axis=1), colour, material)


class Decals:
    """Collects thin flat shapes that lie on the ground."""

    def __init__(self) -> None:
        self._triangles: list[Array] = []
        self._colours: list[Array] = []
        self._materials: list[NDArray[np.uint8]] = []

    def add(self, triangles: ArrayLike, height: float, colour: ArrayLike, material: str) -> None:
        """Add triangles (T, 3, 2), counter-clockwise, with colour (3,) or (T, 3)."""
        xy = np.asarray(triangles, np.float64).reshape(-1, 3, 2)
        self._triangles.append(np.concatenate([xy, np.full((len(xy), 3, 1), height)], axis=2))
        self._colours.append(np.broadcast_to(np.asarray(colour, np.float64), (len(xy), 3)))
        self._materials.append(np.full(len(xy), MATERIAL_INDEX[material], np.uint8))

    def strip(
        self, left: Array, right: Array, height: float, colour: ArrayLike, material: str
    ) -> None:
        """Add a strip between two lines (N, 2) that run along each other."""
        corners = np.stack([right[:-1], right[1:], left[1:], left[:-1]], axis=1)
        colour = np.asarray(colour, np.float64)
        if colour.ndim == 2:
            colour = np.repeat(colour, 2, axis=0)
        self.add(corners[:, [0, 1, 2, 0, 2, 3]].reshape(-1, 3, 2), height, colour, material)

    def polygon(
        self, region: shapely.Geometry, height: float, colour: ArrayLike, material: str
    ) -> None:
        """Add the inside of a polygon."""
        self.add(triangulate(region), height, colour, material)

    def surface(self) -> Surface:
        """All shapes."""
        corners = np.concatenate([np.zeros((0, 3, 3)), *self._triangles])
        made = soup(corners, np.concatenate([np.zeros((0, 3)), *self._colours]), "asphalt")
        materials = np.concatenate([np.zeros(0, np.uint8), *self._materials])
        return Surface(made.vertices, made.faces, made.normals, made.colours, materials)
