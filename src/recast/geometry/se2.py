"""Planar poses (x, y, heading): metres and radians, heading counter-clockwise from x.

A pose array (..., 3) is read as `target_from_source`: the source frame's origin and heading seen in
the target frame.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import ArrayLike

from recast.arrays import Array
from recast.geometry import se3


def wrap_angle(angle: ArrayLike) -> Array:
    """Angles (...) wrapped to [-pi, pi); those within stay as they are, to the last bit."""
    angle = np.asarray(angle, np.float64)
    inside = (angle >= -np.pi) & (angle < np.pi)
    if inside.all():
        return angle.copy()
    wrapped = (angle + np.pi) % (2 * np.pi) - np.pi
    wrapped = np.where(wrapped >= np.pi, -np.pi, wrapped)  # the remainder may round up to 2 pi
    return np.where(inside, angle, wrapped)


def compose(a_from_b: ArrayLike, b_from_c: ArrayLike) -> Array:
    """Poses (..., 3) of c in a; headings are wrapped."""
    a, b = np.asarray(a_from_b, np.float64), np.asarray(b_from_c, np.float64)
    cos, sin = np.cos(a[..., 2]), np.sin(a[..., 2])
    return np.stack(
        [
            a[..., 0] + cos * b[..., 0] - sin * b[..., 1],
            a[..., 1] + sin * b[..., 0] + cos * b[..., 1],
            wrap_angle(a[..., 2] + b[..., 2]),
        ],
        axis=-1,
    )


def inverse(a_from_b: ArrayLike) -> Array:
    """Poses (..., 3) of a in b."""
    a = np.asarray(a_from_b, np.float64)
    cos, sin = np.cos(a[..., 2]), np.sin(a[..., 2])
    return np.stack(
        [
            -cos * a[..., 0] - sin * a[..., 1],
            sin * a[..., 0] - cos * a[..., 1],
            wrap_angle(-a[..., 2]),
        ],
        axis=-1,
    )


def relative(reference: ArrayLike, poses: ArrayLike) -> Array:
    """Poses (..., 3) expressed in the frame of `reference` (..., 3)."""
    return compose(inverse(reference), poses)


def from_se3(matrix: ArrayLike) -> Array:
    """Planar poses (..., 3) of transforms (..., 4, 4): drops z, roll and pitch."""
    matrix = np.asarray(matrix, np.float64)
    return np.stack([matrix[..., 0, 3], matrix[..., 1, 3], se3.yaw(matrix)], axis=-1)


def to_se3(pose: ArrayLike, z: ArrayLike = 0.0) -> Array:
    """Transforms (..., 4, 4) of planar poses (..., 3) at height z (...) in metres."""
    pose = np.asarray(pose, np.float64)
    height = np.broadcast_to(np.asarray(z, np.float64), pose.shape[:-1])
    translation = np.stack([pose[..., 0], pose[..., 1], height], axis=-1)
    return se3.from_rotation_translation(se3.rotation_z(pose[..., 2]), translation)
