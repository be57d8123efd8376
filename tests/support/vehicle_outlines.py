"""Masks of a simple car on a turntable, drawn without a ray tracer."""

from __future__ import annotations

from collections.abc import Sequence

import cv2
import numpy as np

from recast.geometry import se3
from recast.recar.views import camera_pose, pinhole

SIZE = (4.4, 1.8, 1.5)
"""Length, width and height of the car in metres."""
WIDTH, HEIGHT = 240, 160

# (from, to) of x, y, z in metres: body, cabin; the corners are rounded by spheres of 0.15 m.
_BLOCKS = (((-2.2, 2.2), (-0.9, 0.9), (-0.55, 0.15)), ((-1.8, 0.7), (-0.7, 0.7), (0.0, 0.75)))
_WHEELS = [(x, y) for x in (-1.35, 1.35) for y in (-0.8, 0.8)]
_ROUND = 0.15


def turntable_alphas(
    azimuths_deg: Sequence[float] | np.ndarray,
    fov_deg: float = 40.0,
    elevation_deg: float = 12.0,
    distance: float = 9.0,
    turn_deg: tuple[float, float] = (0.0, 0.0),
    size: tuple[int, int] = (WIDTH, HEIGHT),
) -> list[np.ndarray]:
    """Masks (H, W) uint8 of the car from a level camera.

    Args:
        turn_deg: yaw and pitch by which the camera looks past the box centre.
    """
    camera = pinhole(*size, fov_deg)
    masks = []
    for azimuth in azimuths_deg:
        pose = camera_pose(float(azimuth) + turn_deg[0], elevation_deg + turn_deg[1], 1.0)
        pose[:3, 3] = camera_pose(float(azimuth), elevation_deg, distance)[:3, 3]
        mask = np.zeros((4 * size[1], 4 * size[0]), np.uint8)
        for part in _parts():
            pixels, _ = camera.project(se3.apply(se3.inverse(pose), part))
            hull = cv2.convexHull(np.round(pixels * 4 * 256).astype(np.int32))
            cv2.fillConvexPoly(mask, hull, 255, cv2.LINE_8, 8)
        masks.append(np.asarray(cv2.resize(mask, size, interpolation=cv2.INTER_AREA)))
    return masks


def _parts() -> list[np.ndarray]:
    """Points whose convex hulls make up the car."""
    sphere = np.random.default_rng(0).normal(size=(80, 3))
    sphere *= _ROUND / np.linalg.norm(sphere, axis=1, keepdims=True)
    sphere = np.concatenate([sphere, _ROUND * np.eye(3), -_ROUND * np.eye(3)])
    parts = []
    for block in _BLOCKS:
        inner = [(low + _ROUND, high - _ROUND) for low, high in block]
        corners = np.stack(np.meshgrid(*inner), axis=-1).reshape(-1, 3)
        parts.append((corners[:, None] + sphere).reshape(-1, 3))
    angles = np.linspace(0, 2 * np.pi, 32, endpoint=False)
    for x, y in _WHEELS:
        ring = np.stack([x + 0.32 * np.cos(angles), 0 * angles, -0.43 + 0.32 * np.sin(angles)], 1)
        parts.append(np.concatenate([ring + np.array([0, y + side, 0]) for side in (-0.1, 0.1)]))
    return parts
