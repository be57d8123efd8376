"""Oriented boxes: size (l, w, h) in metres, box frame at the centre, x forward, y left, z up."""

from __future__ import annotations

import numpy as np
from numpy.typing import ArrayLike, NDArray

from recast.geometry import se3
from recast.geometry.camera import PinholeCamera

Array = NDArray[np.float64]
BoolArray = NDArray[np.bool_]

# Counter-clockwise from front left, bottom face first: the order of `corners` and `bev_corners`.
_BEV_SIGNS = np.array([[1, 1], [-1, 1], [-1, -1], [1, -1]], np.float64)
EDGES = tuple(
    [(i, (i + 1) % 4) for i in range(4)]
    + [(4 + i, 4 + (i + 1) % 4) for i in range(4)]
    + [(i, i + 4) for i in range(4)]
)
"""The twelve edges of a box, as pairs of indices into `corners`."""


def corners(size: ArrayLike, target_from_box: ArrayLike | None = None) -> Array:
    """Corners (..., 8, 3) of boxes of size (..., 3), in the target frame if a pose is given.

    Order: bottom face front left, rear left, rear right, front right, then the top face alike.
    """
    half = np.asarray(size, np.float64) / 2
    signs = np.concatenate([np.c_[_BEV_SIGNS, -np.ones(4)], np.c_[_BEV_SIGNS, np.ones(4)]], axis=0)
    local = signs * half[..., None, :]
    return local if target_from_box is None else se3.apply(target_from_box, local)


def lattice(size: ArrayLike, target_from_box: ArrayLike, count: int = 5) -> Array:
    """Regular points (count^3, 3) inside a box of size (3,), up to 90 % of its half sides."""
    axes = [np.linspace(-0.9, 0.9, count)] * 3
    local = np.stack(np.meshgrid(*axes, indexing="ij"), -1).reshape(-1, 3)
    return se3.apply(target_from_box, local * np.asarray(size, np.float64) / 2)


def contains(
    points: ArrayLike, size: ArrayLike, target_from_box: ArrayLike, margin: float = 0.0
) -> BoolArray:
    """Which points (N, 3) lie in a box of size (3,) grown by `margin` metres on every side."""
    local = se3.apply(se3.inverse(target_from_box), points)
    inside: BoolArray = np.all(np.abs(local) <= np.asarray(size, np.float64) / 2 + margin, axis=-1)
    return inside


def bev_corners(poses: ArrayLike, length: ArrayLike, width: ArrayLike) -> Array:
    """Bird's-eye corners (..., 4, 2), counter-clockwise from front left.

    Args:
        poses: (..., 3) x, y, heading of the box centre.
        length, width: (...) metres.
    """
    poses = np.asarray(poses, np.float64)
    half = np.stack(
        np.broadcast_arrays(np.asarray(length, np.float64) / 2, np.asarray(width, np.float64) / 2),
        axis=-1,
    )
    local = _BEV_SIGNS * half[..., None, :]
    cos, sin = np.cos(poses[..., 2])[..., None], np.sin(poses[..., 2])[..., None]
    x = poses[..., 0, None] + cos * local[..., 0] - sin * local[..., 1]
    y = poses[..., 1, None] + sin * local[..., 0] + cos * local[..., 1]
    return np.stack([x, y], axis=-1)


def convex_intersection_area(first: ArrayLike, second: ArrayLike) -> float:
    """Area in square metres common to two convex counter-clockwise polygons (N, 2), (M, 2).

    Sutherland-Hodgman clipping, exact up to rounding.
    """
    polygon = np.asarray(first, np.float64)
    clip = np.asarray(second, np.float64)
    for start, end in zip(clip, np.roll(clip, -1, axis=0), strict=True):
        if len(polygon) == 0:
            return 0.0
        edge = end - start
        side = edge[0] * (polygon[:, 1] - start[1]) - edge[1] * (polygon[:, 0] - start[0])
        kept: list[Array] = []
        for i in range(len(polygon)):
            j = (i + 1) % len(polygon)
            if side[i] >= 0:
                kept.append(polygon[i])
            if (side[i] > 0 > side[j]) or (side[i] < 0 < side[j]):
                t = side[i] / (side[i] - side[j])
                kept.append(polygon[i] + t * (polygon[j] - polygon[i]))
        polygon = np.array(kept).reshape(-1, 2)
    if len(polygon) < 3:
        return 0.0
    x, y = (polygon - polygon[0]).T  # a far origin would cost digits in the products
    return float(0.5 * abs(np.dot(x, np.roll(y, -1)) - np.dot(y, np.roll(x, -1))))


def bev_overlap_area(
    pose_a: ArrayLike, size_a: ArrayLike, pose_b: ArrayLike, size_b: ArrayLike
) -> float:
    """Bird's-eye overlap in square metres of two boxes.

    Args:
        pose_a, pose_b: (3,) x, y, heading of the box centres.
        size_a, size_b: (>=2,) length and width in metres.
    """
    pose_a, pose_b = np.asarray(pose_a, np.float64), np.asarray(pose_b, np.float64)
    size_a, size_b = np.asarray(size_a, np.float64), np.asarray(size_b, np.float64)
    reach = (np.hypot(*size_a[:2]) + np.hypot(*size_b[:2])) / 2
    if np.hypot(*(pose_a[:2] - pose_b[:2])) > reach:
        return 0.0
    shift = np.array([*pose_a[:2], 0.0])
    return convex_intersection_area(
        bev_corners(pose_a - shift, size_a[0], size_a[1]),
        bev_corners(pose_b - shift, size_b[0], size_b[1]),
    )


def silhouette(
    size: ArrayLike, camera_from_box: ArrayLike, camera: PinholeCamera, near: float = 0.1
) -> Array:
    """Pixels (N, 2) whose convex hull is the image of a box; none where it is all behind `near`.

    Edges that cross the near plane are cut there, so a box beside the camera keeps a finite,
    correct outline.
    """
    points = corners(size, camera_from_box)
    visible = [p for p in points if p[2] >= near]
    for i, j in EDGES:
        a, b = points[i], points[j]
        if (a[2] < near) != (b[2] < near):
            t = (near - a[2]) / (b[2] - a[2])
            visible.append(a + t * (b - a))
    if not visible:
        return np.zeros((0, 2))
    pixels, _ = camera.rectified().project(np.array(visible))
    return pixels


def project(
    size: ArrayLike, camera_from_box: ArrayLike, camera: PinholeCamera, near: float = 0.1
) -> Array | None:
    """Image rectangle (left, top, right, bottom) in pixels around a projected box, not clipped.

    Returns:
        (4,) or None where the whole box lies behind the near plane; see `silhouette`.
    """
    pixels = silhouette(size, camera_from_box, camera, near)
    if len(pixels) == 0:
        return None
    return np.concatenate([pixels.min(axis=0), pixels.max(axis=0)])
