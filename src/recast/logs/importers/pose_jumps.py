"""Ego poses that cannot belong to one drive."""

from __future__ import annotations

import numpy as np

from recast.logs.types import Array, Int64Array

FASTEST = 100.0
"""Metres a second that an ego may go between two poses, beside a metre of jitter."""


def first_jump(timestamps_us: Int64Array, poses: Array) -> tuple[int, float] | None:
    """The first pose that is too far from the one before, and how far, in metres.

    Args:
        timestamps_us: (T,) int64, not decreasing.
        poses: (T, 4, 4).
    """
    passed = np.diff(timestamps_us) / 1e6
    moved = np.linalg.norm(np.diff(poses[:, :3, 3], axis=0), axis=1)
    wrong = np.flatnonzero(moved > 1.0 + FASTEST * passed)
    return (int(wrong[0]) + 1, float(moved[wrong[0]])) if len(wrong) else None
