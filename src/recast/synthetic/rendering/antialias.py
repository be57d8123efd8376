"""Where one ray a pixel is too few, and light for the further rays there."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from recast.synthetic.rendering.embree import BoolArray, Float32Array
from recast.synthetic.rendering.light_filter import PLANE_TOLERANCE
from recast.synthetic.rendering.lighting import Light
from recast.synthetic.rendering.reflection import MIRROR_ROUGHNESS
from recast.synthetic.rendering.surface_points import TABLE, SurfacePoints
from recast.synthetic.rendering.vectors import dot, rows, scaled

Array = NDArray[np.float64]

OFFSETS = np.array([[-1, -3], [3, -1], [1, 3], [-3, 1]], np.float64) / 8
"""Places of the further rays in a pixel, from its centre: a rotated grid."""
COLOUR_STEP = np.float32(0.04)
"""Difference of two face colours that makes an edge."""
CONTRAST = np.float32(0.15)
"""Difference of what two mirrors show, in square roots of white, that makes an edge."""
LEAST_LIKENESS = np.float32(0.2)
"""Sum of weights that neighbours must have for light to be borrowed from them."""


def edge_pixels(
    points: SurfacePoints,
    pixels: NDArray[np.int64],
    radiance: Float32Array,
    white: float,
    height: int,
    width: int,
) -> NDArray[np.int64]:
    """Pixels (row major) whose surface differs from that of a neighbour.

    Differs in instance, material, normal, distance or colour, and for mirrors in what they show.
    """
    count = height * width
    # Sky keeps zeros: its normal differs from all.
    flat_planes = np.zeros((8, count), np.float32)
    flat_planes[0:3, pixels] = points.flat.T
    flat_planes[3, pixels] = 1 / np.maximum(points.distance, np.float32(1e-3))
    flat_planes[4, pixels] = points.colour @ np.array([0.5, 0.9, 0.25], np.float32)
    mirror = (TABLE.specular[points.material] > 0) & (
        TABLE.roughness[points.material] <= MIRROR_ROUGHNESS
    )
    shown = np.sqrt(np.minimum(radiance[:, 1] / np.float32(white), 2))
    flat_planes[5, pixels] = np.where(mirror, shown, 0) / CONTRAST
    flat_planes[6, pixels] = points.material
    flat_planes[7, pixels] = points.instance
    planes = flat_planes.reshape(8, height, width)
    edge = np.zeros((height, width), bool)
    for axis in (0, 1):
        first = (slice(None),) * axis + (slice(None, -1),)
        second = (slice(None),) * axis + (slice(1, None),)
        differs = _differ(planes[:, *first], planes[:, *second])
        edge[first] |= differs
        edge[second] |= differs
    return np.flatnonzero(edge)


def _differ(first: Float32Array, second: Float32Array) -> BoolArray:
    dot = first[0] * second[0]
    dot += first[1] * second[1]
    dot += first[2] * second[2]
    hit = (first[3] > 0) | (second[3] > 0)
    differs = (dot < 0.9) & hit
    # The inverse of distance is linear on a plane: a step is an edge, a slope is not.
    steep = np.minimum(first[3], second[3]) < np.float32(0.8) * np.maximum(first[3], second[3])
    differs |= steep & (np.minimum(first[3], second[3]) > 0)
    differs |= np.abs(first[4] - second[4]) > COLOUR_STEP
    differs |= (first[6] == second[6]) & (np.abs(first[5] - second[5]) > 1)
    differs |= first[6] != second[6]
    differs |= first[7] != second[7]
    return differs


def borrow_light(
    points: SurfacePoints,
    pixels: NDArray[np.int64],
    arriving: Light,
    others: SurfacePoints,
    other_pixels: NDArray[np.int64],
    place: Array,
    height: int,
    width: int,
) -> tuple[Light, NDArray[np.int64]]:
    """Light of further points from smoothed light in the 3 x 3 pixels about them.

    Args:
        points, pixels, arriving: of the centre rays.
        others, other_pixels: the further points and the pixel that each lies in.
        place: (2,) where in the pixel, one of `OFFSETS`.

    Returns:
        their light, and the indices of those that found no like surface nearby.
    """
    wide = width + 2
    table = np.zeros(((height + 2) * wide, 10), np.float32)
    row = (pixels // width + 1) * wide + pixels % width + 1
    table[row, 0:3], table[row, 3:6] = points.position, points.normal
    table[row, 6], table[row, 7:] = arriving.sun, arriving.sky
    centre = (other_pixels // width + 1) * wide + other_pixels % width + 1
    borrowed = np.zeros((len(others), 4), np.float32)
    # The four pixels whose centres lie nearest serve most; the rest look further.
    right, down = (1 if offset > 0 else -1 for offset in place)
    near = ((0, 0), (right, 0), (0, down), (right, down))
    far = [(x, y) for y in (-1, 0, 1) for x in (-1, 0, 1) if (x, y) not in near]
    left = np.arange(len(others))
    for steps in (near, far):
        total, value = _gather(
            table,
            [rows(centre, left) + x + y * wide for x, y in steps],
            others.take(left) if len(left) < len(others) else others,
        )
        found = total >= LEAST_LIKENESS
        index = np.flatnonzero(found)
        borrowed[left[index]] = rows(value, index) / rows(total, index)[:, None]
        left = left[~found]
    return Light(borrowed[:, 0].copy(), np.ascontiguousarray(borrowed[:, 1:])), left


def _gather(
    table: Float32Array, places: list[NDArray[np.int64]], points: SurfacePoints
) -> tuple[Float32Array, Float32Array]:
    """Sums of likeness (N,) and of light times likeness (N, 4) over rows of `table`."""
    tolerance = 1 / (PLANE_TOLERANCE * (1 + np.float32(0.1) * points.distance))
    foot = dot(points.position, points.normal)
    total = np.zeros(len(points), np.float32)
    value = np.zeros((len(points), 4), np.float32)
    for place in places:
        near = rows(table, place)
        weight = np.maximum(dot(near[:, 3:6], points.normal), 0)
        weight *= weight
        weight *= weight
        weight *= weight
        off = (dot(near[:, :3], points.normal) - foot) * tolerance
        weight /= 1 + off * off
        total += weight
        value += scaled(near[:, 6:], weight)
    return total, value
