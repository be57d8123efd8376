"""The readable reference of `RayScene.cast`: every ray against every triangle."""

from __future__ import annotations

import numpy as np
from numpy.typing import ArrayLike, NDArray

from recast.geometry import se3
from recast.synthetic.rendering.ray_scene import SKY, Hits, Poses, RayScene

Array = NDArray[np.float64]


def cast(scene: RayScene, origins: ArrayLike, directions: ArrayLike, poses: Poses) -> Hits:
    """As `RayScene.cast`, in float64 without any acceleration: N x F work and memory."""
    origins = np.asarray(origins, np.float64)
    directions = np.asarray(directions, np.float64)
    count = len(directions)
    distance, face = np.full(count, np.inf), np.full(count, -1, np.int32)
    instance = np.full(count, SKY, np.uint16)
    u, v = np.zeros(count), np.zeros(count)
    placed = [(0, scene.static.vertices[scene.static.faces])]
    for index, name in enumerate(scene.names, 1):
        if name in poses:
            model = scene.models[name]
            placed.append((index, se3.apply(poses[name], model.vertices)[model.faces]))
    for index, triangles in placed:
        if not len(triangles):
            continue
        t, at_u, at_v = intersect(origins, directions, triangles)
        nearest = np.argmin(t, axis=1)
        rays = np.arange(count)
        closer = t[rays, nearest] < distance
        distance = np.where(closer, t[rays, nearest], distance)
        face = np.where(closer, nearest, face).astype(np.int32)
        instance[closer] = index
        u = np.where(closer, at_u[rays, nearest], u)
        v = np.where(closer, at_v[rays, nearest], v)
    return Hits(
        distance.astype(np.float32), instance, face, u.astype(np.float32), v.astype(np.float32)
    )


def intersect(origins: Array, directions: Array, triangles: Array) -> tuple[Array, Array, Array]:
    """Distances (N, F), inf where missed, and barycentric u, v of rays (N, 3) on (F, 3, 3).

    Moller and Trumbore, "Fast, minimum storage ray-triangle intersection" (1997), both sides.
    """
    first = triangles[:, 1] - triangles[:, 0]
    second = triangles[:, 2] - triangles[:, 0]
    across = np.cross(directions[:, None], second[None])
    determinant = np.sum(across * first, axis=-1)
    safe = np.where(np.abs(determinant) < 1e-14, np.nan, determinant)
    offset = origins[:, None] - triangles[None, :, 0]
    u = np.sum(offset * across, axis=-1) / safe
    turned = np.cross(offset, first[None])
    v = np.sum(directions[:, None] * turned, axis=-1) / safe
    t = np.sum(second[None] * turned, axis=-1) / safe
    hit = (u >= 0) & (v >= 0) & (u + v <= 1) & (t > 0)
    return np.where(hit, t, np.inf), u, v
