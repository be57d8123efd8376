"""Directions to sample light from, spread so that neighbouring pixels complete one another.

Every aligned block of 8 x 8 pixels holds the first 64 points of Sobol's (0, 2)-sequence in Morton
order, so that each aligned 2 x 2 and 4 x 4 block is stratified as well; a filter over a few pixels
then sees as many well spread samples. Each block is shifted at random (Cranley-Patterson rotation).
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from recast.synthetic.rendering.embree import Float32Array
from recast.synthetic.rendering.vectors import normalise, shift

Array = NDArray[np.float64]
TILE = 8


def _net() -> Float32Array:
    """(8, 8, 2) the first 64 points of the (0, 2)-sequence, in Morton order."""
    index = np.arange(TILE * TILE)
    bits = (index[:, None] >> np.arange(6)) & 1
    radical = bits @ (0.5 ** np.arange(1, 7))
    # Second Sobol dimension: direction numbers of the Pascal matrix modulo 2.
    pascal = np.array([[1 if (row & col) == row else 0 for col in range(6)] for row in range(6)])
    second = ((bits @ pascal.T) % 2) @ (0.5 ** np.arange(1, 7))
    x = bits[:, 0] + 2 * bits[:, 2] + 4 * bits[:, 4]
    y = bits[:, 1] + 2 * bits[:, 3] + 4 * bits[:, 5]
    tile = np.zeros((TILE, TILE, 2), np.float32)
    tile[y, x] = np.stack([radical, second], axis=1)
    return tile


_NET = _net()


def pixel_samples(height: int, width: int, rng: np.random.Generator) -> Float32Array:
    """One point (height, width, 2) of [0, 1)^2 a pixel, stratified over neighbouring pixels."""
    rows, columns = -(-height // TILE), -(-width // TILE)
    shift = rng.random((rows, 1, columns, 1, 2), np.float32)
    points = (shift + _NET[None, :, None, :, :]) % np.float32(1)
    points = points.reshape(rows * TILE, columns * TILE, 2)
    return np.ascontiguousarray(points[:height, :width])


def cosine_directions(normals: Float32Array, samples: Float32Array) -> Float32Array:
    """Unit directions (N, 3) about unit normals (N, 3), in proportion to the cosine.

    Points of the unit sphere about the normal's tip, seen from its foot.
    """
    z = 1 - 2 * samples[:, 0]
    radius = np.sqrt(np.maximum(1 - z * z, 0))
    angle = np.float32(2 * np.pi) * samples[:, 1]
    directions = normals * np.float32(1.0001)  # never exactly opposite: a direction of length zero
    directions[:, 0] += radius * np.cos(angle)
    directions[:, 1] += radius * np.sin(angle)
    directions[:, 2] += z
    return normalise(directions)


def disc_directions(centre: Array, radius: float, samples: Float32Array) -> Float32Array:
    """Unit directions (N, 3) to points of a disc of angular `radius` about the unit `centre`."""
    side = np.cross(centre, [1.0, 0, 0] if abs(centre[0]) < 0.9 else [0, 1.0, 0])
    side /= np.linalg.norm(side)
    reach = np.sqrt(samples[:, 0]) * np.float32(np.tan(radius))
    angle = np.float32(2 * np.pi) * samples[:, 1]
    axes = np.stack([side, np.cross(centre, side)]).astype(np.float32)
    plane = np.stack([reach * np.cos(angle), reach * np.sin(angle)], axis=1)
    return normalise(shift(plane @ axes, centre.astype(np.float32)))
