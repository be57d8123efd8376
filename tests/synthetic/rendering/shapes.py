"""Small scenes for the tests."""

from __future__ import annotations

import numpy as np

from recast.geometry import PinholeCamera, se3
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
