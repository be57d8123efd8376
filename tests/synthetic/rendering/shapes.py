"""Small scenes for the tests."""

from __future__ import annotations

import numpy as np
from numpy.typing import ArrayLike

from recast.arrays import Array
from recast.cameras import PinholeCamera
from recast.geometry import se3
from recast.synthetic.rendering import SKY, Hits, RayScene
from recast.synthetic.rendering.rays import Poses
from recast.synthetic.surface import Surface, concatenate
from recast.synthetic.world import Sky

CAMERA = PinholeCamera(64, 48, 60.0, 60.0, 32.0, 24.0)
FORWARD = np.array([[0.0, 0, 1], [-1, 0, 0], [0, -1, 0]])
"""world_from_camera rotation of a camera that looks along +x, upright."""


def plane(colour: object = (0.2, 0.2, 0.2), material: str = "asphalt", z: float = 0.0) -> Surface:
    corners = [[-200, -200, z], [200, -200, z], [200, 200, z], [-200, 200, z]]
    return Surface.make(corners, [[0, 1, 2], [0, 2, 3]], colour, material)


def box(
    size: tuple[float, float, float] = (4.0, 1.8, 1.5),
    colour: object = (0.5, 0.1, 0.1),
    material: str = "matte",
) -> Surface:
    """A box about the origin, outward faces."""
    x, y, z = np.array(size) / 2
    corners = [[a, b, c] for a in (-x, x) for b in (-y, y) for c in (-z, z)]
    quads = [(0, 1, 3, 2), (4, 6, 7, 5), (0, 4, 5, 1), (2, 3, 7, 6), (0, 2, 6, 4), (1, 5, 7, 3)]
    faces = [t for a, b, c, d in quads for t in ((a, b, c), (a, c, d))]
    return Surface.make(corners, faces, colour, material, crease=0)


def nothing() -> Surface:
    return concatenate([])


def sky(elevation: float = 50.0, clouds: float = 0.3) -> Sky:
    high = np.deg2rad(elevation)
    direction = np.array([0.0, np.cos(high), np.sin(high)])
    return Sky(
        direction,
        np.array([3.0, 2.8, 2.5]),
        np.array([0.2, 0.35, 0.6]),
        np.array([0.65, 0.72, 0.8]),
        clouds=clouds,
    )


def camera_at(x: float, y: float, z: float) -> np.ndarray:
    return se3.from_rotation_translation(FORWARD, [x, y, z])


def pose(x: float, y: float, z: float = 0.75, yaw: float = 0.0) -> np.ndarray:
    return se3.from_rotation_translation(se3.rotation_z(yaw), [x, y, z])


def brute_force_cast(
    scene: RayScene, origins: ArrayLike, directions: ArrayLike, poses: Poses
) -> Hits:
    """The readable reference of `RayScene.cast`: float64, N x F work and memory."""
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
