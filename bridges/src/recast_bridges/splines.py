"""Poses at any time from a few poses of a planned trajectory."""

from __future__ import annotations

import numpy as np
from numpy.typing import ArrayLike
from scipy.interpolate import CubicSpline

from recast.arrays import Array
from recast.geometry import se2


def spline_through(knots: ArrayLike, poses: ArrayLike, times: ArrayLike) -> Array:
    """Poses (M, 3) at times within the knots.

    x, y and the unwrapped heading are each a cubic spline over time (not-a-knot, so continuous in
    acceleration). So every given pose, its heading included, is met exactly, and constant
    acceleration stays constant; linear interpolation would jerk at each pose. Headings are never
    derived from the path, so that they survive standing still.

    Args:
        knots: (N,) times of the poses in seconds, strictly increasing, N at least 2.
        poses: (N, 3) x, y, heading.
        times: (M,) seconds.
    """
    through = np.array(poses, np.float64)
    through[:, 2] = np.unwrap(through[:, 2])
    found: Array = CubicSpline(knots, through)(times)
    found[:, 2] = se2.wrap_angle(found[:, 2])
    return found
