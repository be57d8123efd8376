"""Who touches whom, and who hides whom, seen from above, at all times of a log at once.

Footprints are given by planar poses (T, 3) of box centres and (length, width) in metres.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import ArrayLike, NDArray

from recast.geometry import boxes

Array = NDArray[np.float64]
Times = NDArray[np.bool_]


def touching(
    poses_a: Array, size_a: ArrayLike, poses_b: Array, size_b: ArrayLike, margin: float = 0.0
) -> Times:
    """At which times (T,) two rectangles come closer than about `margin` metres.

    Separating axes: rectangles are apart exactly where one of their four side directions parts
    them.
    """
    grow = np.array([margin, margin])
    a = boxes.bev_corners(poses_a, *(np.asarray(size_a, np.float64)[:2] + grow))
    b = boxes.bev_corners(poses_b, *(np.asarray(size_b, np.float64)[:2] + grow))
    apart = np.zeros(np.broadcast_shapes(a.shape[:-2], b.shape[:-2]), bool)
    for heading in (poses_a[..., 2], poses_b[..., 2]):
        for turn in (0.0, np.pi / 2):
            axis = np.stack([np.cos(heading + turn), np.sin(heading + turn)], axis=-1)
            along_a = np.einsum("...kd,...d->...k", a, axis)
            along_b = np.einsum("...kd,...d->...k", b, axis)
            apart |= along_a.max(axis=-1) < along_b.min(axis=-1)
            apart |= along_b.max(axis=-1) < along_a.min(axis=-1)
    return ~apart


def hiding(
    eyes: Array, target: Array, target_size: ArrayLike, other: Array, other_size: ArrayLike
) -> Times:
    """At which times (T,) `other` cuts a sight line from `eyes` (T, 2) to the target's box."""
    length, width = np.asarray(target_size, np.float64)[:2]
    ends = np.concatenate([boxes.bev_corners(target, length, width), target[:, None, :2]], axis=1)
    half = np.asarray(other_size, np.float64)[:2] / 2
    start = _in_frame(other, eyes[:, None])
    step = _in_frame(other, ends) - start
    step = np.where(np.abs(step) < 1e-12, 1e-12, step)
    near, far = (-half - start) / step, (half - start) / step
    enter = np.minimum(near, far).max(axis=-1)
    leave = np.maximum(near, far).min(axis=-1)
    cut = (enter <= leave) & (leave >= 0) & (enter <= 1)
    hidden: Times = cut.any(axis=-1)
    return hidden


def _in_frame(poses: Array, points: Array) -> Array:
    """Points (T, K, 2) in the frames of poses (T, 3)."""
    offset = points - poses[:, None, :2]
    cos, sin = np.cos(poses[:, None, 2]), np.sin(poses[:, None, 2])
    return np.stack(
        [
            cos * offset[..., 0] + sin * offset[..., 1],
            cos * offset[..., 1] - sin * offset[..., 0],
        ],
        axis=-1,
    )
