"""Where one ray a pixel is too few, and light for the further rays there."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from recast.synthetic.rendering.embree import BoolArray, Float32Array
from recast.synthetic.rendering.lighting import Light
from recast.synthetic.rendering.reflection import MIRROR_ROUGHNESS
from recast.synthetic.rendering.surface_points import TABLE, SurfacePoints

OFFSETS = np.array([[-1, -3], [3, -1], [1, 3], [-3, 1]], np.float64) / 8
"""Places of the further rays in a pixel, from its centre: a rotated grid."""
COLOUR_STEP = np.float32(0.04)
CONTRAST = np.float32(0.15)


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
    flat_planes[3, pixels] = 1 / points.distance
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
    height: int,
    width: int,
) -> tuple[Light, NDArray[np.int64]]:
    """Light of further points from smoothed light in the 3 x 3 pixels about them.

    Args:
        points, pixels, arriving: of the centre rays.
        others, other_pixels: the further points and the pixel that each lies in.

    Returns:
        their light, and the indices of those that found no like surface nearby.
    """
    table = np.zeros(((height + 2) * (width + 2), 10), np.float32)
    row = (pixels // width + 1) * (width + 2) + pixels % width + 1
    table[row, 0:3], table[row, 3:6] = points.position, points.normal
    table[row, 6], table[row, 7:] = arriving.sun, arriving.sky
    centre = (other_pixels // width + 1) * (width + 2) + other_pixels % width + 1
    tolerance = 1 / (np.float32(0.02) * (1 + np.float32(0.1) * others.distance))
    total = np.zeros(len(others), np.float32)
    value = np.zeros((len(others), 4), np.float32)
    for down in (-1, 0, 1):
        for right in (-1, 0, 1):
            near = table[centre + down * (width + 2) + right]
            weight = np.maximum(np.einsum("ij,ij->i", near[:, 3:6], others.normal), 0) ** 8
            off = np.einsum("ij,ij->i", near[:, :3] - others.position, others.normal) * tolerance
            weight /= 1 + off * off
            total += weight
            value += weight[:, None] * near[:, 6:]
    alone = np.flatnonzero(total < 0.2)
    value /= np.maximum(total, np.float32(1e-6))[:, None]
    return Light(value[:, 0], value[:, 1:]), alone
