"""Trajectories at any interval as waypoints at the simulator's."""

from __future__ import annotations

import numpy as np
from numpy.typing import ArrayLike, NDArray
from scipy.interpolate import CubicSpline

from recast.geometry import se2

Array = NDArray[np.float64]

_SAME_TIME = 1e-6


def resample(poses: ArrayLike, interval: float, times: ArrayLike) -> Array:
    """Waypoints (M, 3) at `times` from poses (N, 3) that are `interval` seconds apart.

    x, y and the unwrapped heading are each a cubic spline over time (not-a-knot, so continuous in
    acceleration) through the present pose at 0 and all the given ones. So every given pose, its
    heading included, is met exactly, and constant acceleration stays constant; linear
    interpolation would jerk at each pose. Headings are never derived from the path, so that they
    survive standing still. Poses that have the asked times are returned as they are.

    Args:
        poses: x, y, heading in the present ego frame at interval, 2 interval, ...
        times: (M,) seconds from now, none later than the last pose.

    Raises:
        ValueError: the poses end before `times`, or are not finite (N, 3).
    """
    try:
        poses = np.asarray(poses, np.float64)
    except (TypeError, ValueError):
        raise ValueError("its poses are no array of numbers") from None
    times = np.asarray(times, np.float64)
    if poses.ndim != 2 or poses.shape[1] != 3 or len(poses) == 0:
        raise ValueError(f"its poses have shape {poses.shape}, not (N, 3)")
    if not np.isfinite(poses).all():
        first = int(np.argmax(~np.isfinite(poses).all(axis=1)))
        raise ValueError(f"pose {first} holds NaN or infinity")
    if not (np.isfinite(interval) and interval > 0):
        raise ValueError(f"its poses are {interval} s apart")
    knots = interval * np.arange(len(poses) + 1)
    if knots[-1] < times[-1] - _SAME_TIME:
        raise ValueError(
            f"its {len(poses)} poses every {interval:g} s end at {knots[-1]:g} s, "
            f"{times[-1]:g} s are needed"
        )
    if len(poses) >= len(times) and np.allclose(
        knots[1 : len(times) + 1], times, rtol=0, atol=_SAME_TIME
    ):
        return poses[: len(times)].copy()
    through = np.concatenate([np.zeros((1, 3)), poses])
    through[:, 2] = np.unwrap(through[:, 2])
    waypoints: Array = CubicSpline(knots, through)(times)
    waypoints[:, 2] = se2.wrap_angle(waypoints[:, 2])
    return waypoints
