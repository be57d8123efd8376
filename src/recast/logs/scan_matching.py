"""Point-to-plane matching of one LiDAR sweep to a map of earlier ones."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from scipy.spatial import cKDTree

from recast.geometry import se3
from recast.logs.types import Array

NEAREST, FARTHEST = 3.0, 50.0  # metres of a sweep that are used
VOXEL = 0.5  # metres between matched points
NEIGHBOURS = 12
FLATNESS = 0.04  # metres, standard deviation across a surface
EXTENT = 0.08  # metres, along it: below this, neighbours lie on one scan line
SIGMA = 0.05  # metres, scale of the robust weight
NOISE = (
    0.3  # metres: scale of one residual against the prior; neighbours' errors are not independent
)
PRIOR_SIGMA = np.array([0.05, 0.05, 0.03, 0.002, 0.002, 0.003])  # metres, radians: of the guess
GATES = (1.0, 0.6, 0.4, 0.3, 0.3, 0.3, 0.3, 0.3)  # metres to the nearest map point, by iteration


@dataclass(frozen=True)
class Surfels:
    """Points with the normals of the surface around them.

    Attributes:
        points, normals: (N, 3).
    """

    points: Array
    normals: Array

    def moved(self, target_from_source: Array) -> Surfels:
        """The same surfels in another frame."""
        return Surfels(
            se3.apply(target_from_source, self.points),
            self.normals @ target_from_source[:3, :3].T,
        )


def thin(points: Array) -> Array:
    """One point (M, 3) of each voxel of a sweep (N, 3), between the nearest and farthest range."""
    distance = np.linalg.norm(points[:, :2], axis=1)
    kept = points[(distance > NEAREST) & (distance < FARTHEST)].astype(np.float64)
    voxel = np.floor(kept / VOXEL).astype(np.int64)
    key = (voxel[:, 0] * 4096 + voxel[:, 1]) * 4096 + voxel[:, 2]
    _, first = np.unique(key, return_index=True)
    return kept[np.sort(first)]


def surfels(points: Array, at: Array) -> Surfels:
    """Surfels at points `at` (M, 3) of a sweep (N, 3), where the sweep is flat there."""
    if len(points) < NEIGHBOURS:
        return Surfels(np.zeros((0, 3)), np.zeros((0, 3)))
    tree = cKDTree(points)
    _, index = tree.query(at, k=NEIGHBOURS)
    around = points[index]
    centred = around - around.mean(axis=1, keepdims=True)
    spread, axes = np.linalg.eigh(np.einsum("nki,nkj->nij", centred, centred) / NEIGHBOURS)
    flat = (spread[:, 0] < FLATNESS**2) & (spread[:, 1] > EXTENT**2)
    return Surfels(around.mean(axis=1)[flat], axes[flat, :, 0])


def match(points: Array, world: Surfels, guess: Array) -> Array:
    """Pose (4, 4) `world_from_sweep` of points (N, 3) against a map.

    Gauss-Newton on point-to-plane distances with Geman-McClure weights, held to the guess where
    the map says little: along a tunnel the guess stays.

    Args:
        guess: (4, 4) `world_from_sweep` to start from.
    """
    tree = cKDTree(world.points)
    pose = guess.copy()
    prior = np.diag(1.0 / PRIOR_SIGMA**2)
    for gate in GATES:
        moved = se3.apply(pose, points)
        distance, nearest = tree.query(moved, distance_upper_bound=gate)
        hit = np.isfinite(distance)
        local, normals = points[hit], world.normals[nearest[hit]] @ pose[:3, :3]
        residual = np.einsum(
            "ni,ni->n", moved[hit] - world.points[nearest[hit]], world.normals[nearest[hit]]
        )
        weight = 1.0 / (1.0 + (residual / SIGMA) ** 2) ** 2 / NOISE**2
        jacobian = np.concatenate([normals, np.cross(local, normals)], axis=1)
        off = se3.log(se3.inverse(guess) @ pose)
        hessian = (jacobian * weight[:, None]).T @ jacobian + prior
        gradient = (jacobian * weight[:, None]).T @ residual + prior @ off
        step = -np.linalg.solve(hessian, gradient)
        pose = pose @ se3.exp(step)
        if np.linalg.norm(step) < 1e-5 and gate == GATES[-1]:
            break
    return pose


def adjoint(matrix: Array) -> NDArray[np.float64]:
    """Adjoints (..., 6, 6) of transforms (..., 4, 4), twists ordered as in `se3.exp`."""
    rotation, translation = matrix[..., :3, :3], matrix[..., :3, 3]
    skew = np.zeros_like(rotation)
    skew[..., 2, 1], skew[..., 0, 2], skew[..., 1, 0] = np.moveaxis(translation, -1, 0)
    skew[..., 1, 2], skew[..., 2, 0], skew[..., 0, 1] = np.moveaxis(-translation, -1, 0)
    result = np.zeros((*matrix.shape[:-2], 6, 6))
    result[..., :3, :3] = result[..., 3:, 3:] = rotation
    result[..., :3, 3:] = skew @ rotation
    return result
