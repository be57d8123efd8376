"""Points and normals spread evenly over an implicit surface."""

from __future__ import annotations

from collections.abc import Callable

import numpy as np
from numpy.typing import NDArray

Array = NDArray[np.float64]
Distance = Callable[[Array], Array]


def gradient(distance: Distance, points: Array, value: Array, step: float = 1e-3) -> Array:
    """Forward-difference gradient (N, 3) of `distance` at points (N, 3) of known `value` (N,)."""
    return np.stack(
        [(distance(points + step * axis) - value) / step for axis in np.eye(3)], axis=-1
    )


def project(distance: Distance, points: Array, steps: int) -> Array:
    """Move points (N, 3) to the zero level by Newton steps of at most 5 cm."""
    for _ in range(steps):
        value = distance(points)
        slope = gradient(distance, points, value)
        move = slope * (value / np.maximum(np.sum(slope * slope, axis=1), 1e-3))[:, None]
        length = np.linalg.norm(move, axis=1, keepdims=True)
        points = points - move * np.minimum(1.0, 0.05 / np.maximum(length, 1e-12))
    return points


def voxel_ids(points: Array, spacing: float) -> NDArray[np.int64]:
    """One integer (N,) per voxel of edge `spacing` metres; equal ids share a voxel."""
    cells = np.floor(points / spacing).astype(np.int64)
    cells -= cells.min(axis=0)
    extent = cells.max(axis=0) + 1
    return (cells[:, 0] * extent[1] + cells[:, 1]) * extent[2] + cells[:, 2]


def voxel_means(points: Array, spacing: float) -> Array:
    """Mean of the points in each occupied voxel, (M, 3), ordered by voxel."""
    _, group, count = np.unique(voxel_ids(points, spacing), return_inverse=True, return_counts=True)
    return np.stack(
        [np.bincount(group, weights=points[:, axis]) / count for axis in range(3)], axis=-1
    )


def sample(
    distance: Distance, low: Array, high: Array, spacing: float, rng: np.random.Generator
) -> tuple[Array, Array]:
    """Points (M, 3) about `spacing` metres apart on the zero level, with outward unit normals.

    A coarse grid finds the cells the surface crosses; random points in them are projected to the
    surface and thinned to one mean a voxel.

    Args:
        low, high: (3,) corners of a box around the surface.
        spacing: metres.
    """
    cell = 0.08
    axes = [np.arange(a, b + cell, cell) + cell / 2 for a, b in zip(low, high, strict=True)]
    centres = np.stack(np.meshgrid(*axes, indexing="ij"), axis=-1).reshape(-1, 3)
    centres = centres[np.abs(distance(centres)) < 0.8 * cell]
    seeds_per_cell = max(4, int(np.ceil(1.5 * (cell / spacing) ** 2)))
    seeds = np.repeat(centres, seeds_per_cell, axis=0)
    seeds = seeds + rng.uniform(-cell / 2, cell / 2, seeds.shape)
    seeds = project(distance, seeds, steps=2)
    seeds = seeds[np.all((seeds >= low) & (seeds <= high), axis=1)]
    points = project(distance, voxel_means(seeds, spacing), steps=2)
    value = distance(points)
    points, value = points[np.abs(value) < 2e-3], value[np.abs(value) < 2e-3]
    normals = gradient(distance, points, value)
    normals /= np.linalg.norm(normals, axis=1, keepdims=True)
    return points, normals
