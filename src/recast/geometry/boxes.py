"""Oriented boxes: size (l, w, h) in metres, box frame at the centre, x forward, y left, z up."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from numpy.typing import ArrayLike

from recast.arrays import Array, BoolArray
from recast.geometry import se3

_ROUNDING_M2 = 1e-12  # what boxes that merely touch may seem to have in common
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


def lattice(size: ArrayLike, target_from_box: ArrayLike) -> Array:
    """Regular points (125, 3) inside a box of size (3,), up to 90 % of its half sides."""
    axes = [np.linspace(-0.9, 0.9, 5)] * 3
    local = np.stack(np.meshgrid(*axes, indexing="ij"), -1).reshape(-1, 3)
    return se3.apply(target_from_box, local * np.asarray(size, np.float64) / 2)


def contains(
    points: ArrayLike, size: ArrayLike, target_from_box: ArrayLike, margin: float = 0.0
) -> BoolArray:
    """Which points (N, 3) lie in a box of size (3,) grown by `margin` metres on every side."""
    local = se3.apply(se3.inverse(target_from_box), points)
    return np.all(np.abs(local) <= np.asarray(size, np.float64) / 2 + margin, axis=-1)


def bev_corners(poses: ArrayLike, length: ArrayLike, width: ArrayLike) -> Array:
    """Bird's-eye corners (..., 4, 2), counter-clockwise from front left.

    Args:
        poses: (..., 3) x, y, heading of the box centre.
        length, width: (...) metres.
    """
    poses = np.asarray(poses, np.float64)
    ahead = _BEV_SIGNS[:, 0] * (np.asarray(length, np.float64) / 2)[..., None]
    left = _BEV_SIGNS[:, 1] * (np.asarray(width, np.float64) / 2)[..., None]
    cos, sin = np.cos(poses[..., 2])[..., None], np.sin(poses[..., 2])[..., None]
    x = poses[..., 0, None] + cos * ahead - sin * left
    y = poses[..., 1, None] + sin * ahead + cos * left
    return np.stack([x, y], axis=-1)


TOUCHING = 1e-9
"""Overlap in square metres up to which boxes merely touch."""


def bev_overlap_area(
    poses_a: ArrayLike, size_a: ArrayLike, poses_b: ArrayLike, size_b: ArrayLike
) -> Array:
    """Bird's-eye overlap (...) in square metres of boxes, pair by pair; exact up to rounding.

    The outline of `a` in the frame of `b`, cut where it crosses the lines of b's sides and then
    clamped to `b`, encloses what is common to both: clamping flattens everything else.

    Args:
        poses_a, poses_b: (..., 3) x, y, heading of the box centres.
        size_a, size_b: (..., >=2) length and width in metres.
    """
    a, b = np.asarray(poses_a, np.float64), np.asarray(poses_b, np.float64)
    size_a, size_b = np.asarray(size_a, np.float64), np.asarray(size_b, np.float64)
    shift = a[..., :2] - b[..., :2]  # first of all: a far origin would cost digits
    cos, sin = np.cos(b[..., 2]), np.sin(b[..., 2])
    x, y = cos * shift[..., 0] + sin * shift[..., 1], cos * shift[..., 1] - sin * shift[..., 0]
    start = bev_corners(
        np.stack(np.broadcast_arrays(x, y, a[..., 2] - b[..., 2]), axis=-1),
        size_a[..., 0],
        size_a[..., 1],
    )
    side = np.roll(start, -1, axis=-2) - start
    half = size_b[..., None, :2] / 2
    sides = np.where(side == 0, 1.0, side)  # parallel to b's: it crosses no two of its lines
    cuts = np.concatenate([(-half - start) / sides, (half - start) / sides], axis=-1)
    share = np.sort(np.clip(cuts, 0.0, 1.0), axis=-1)[..., None]
    outline = np.concatenate(
        [start[..., None, :], start[..., None, :] + share * side[..., None, :]], axis=-2
    )
    outline = np.clip(outline, -half[..., None, :], half[..., None, :])
    outline = outline.reshape(*outline.shape[:-3], 20, 2)
    after = np.roll(outline, -1, axis=-2)
    area = (outline[..., 0] * after[..., 1] - outline[..., 1] * after[..., 0]).sum(axis=-1) / 2
    return np.where(area > _ROUNDING_M2, area, 0.0)


def bev_touching(
    poses_a: ArrayLike, size_a: ArrayLike, poses_b: ArrayLike, size_b: ArrayLike
) -> BoolArray:
    """Which boxes (...) touch or overlap, seen from above: none of their four sides parts them.

    Args: as for `bev_depth`.
    """
    found: BoolArray = bev_depth(poses_a, size_a, poses_b, size_b) >= 0
    return found


def bev_depth(
    poses_a: ArrayLike, size_a: ArrayLike, poses_b: ArrayLike, size_b: ArrayLike
) -> Array:
    """Least distance (...) in metres to move one box so that it only touches the other from above.

    Negative for boxes that are apart: the widest gap along the normal of one of their sides, which
    is at most their distance.

    Args:
        poses_a, poses_b: (..., 3) x, y, heading of the box centres.
        size_a, size_b: (>=2,) length and width in metres.
    """
    a, b = np.asarray(poses_a, np.float64), np.asarray(poses_b, np.float64)
    half_a, half_b = np.asarray(size_a)[:2] / 2, np.asarray(size_b)[:2] / 2
    dx, dy, turn = b[..., 0] - a[..., 0], b[..., 1] - a[..., 1], b[..., 2] - a[..., 2]
    cos, sin = np.abs(np.cos(turn)), np.abs(np.sin(turn))
    found = np.full(turn.shape, np.inf)
    for heading, own, other in ((a[..., 2], half_a, half_b), (b[..., 2], half_b, half_a)):
        c, s = np.cos(heading), np.sin(heading)
        ahead = own[0] + other[0] * cos + other[1] * sin - np.abs(dx * c + dy * s)
        aside = own[1] + other[0] * sin + other[1] * cos - np.abs(dy * c - dx * s)
        found = np.minimum(found, np.minimum(ahead, aside))
    return found


def smooth_max(fields: Sequence[Array], radius: float) -> Array:
    """The greatest of signed distances: a box of half spaces whose edges are rounded.

    The polynomial smooth maximum, of one field after the other; never below the maximum.

    Args:
        fields: distances (N,) in metres, negative inside.
        radius: of the edges, in about metres.
    """
    best = fields[0]
    for field in fields[1:]:
        overlap: Array = np.maximum(radius - np.abs(best - field), 0.0)
        best = np.maximum(best, field) + overlap * overlap / (4 * radius)
    return best
