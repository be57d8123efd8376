"""Comfort checks: signals of a plan, nuPlan's smoothed ones of a motion, and their limits."""

from __future__ import annotations

from collections.abc import Mapping
from functools import lru_cache

import numpy as np
from numpy.typing import ArrayLike

from recast.arrays import Array, BoolArray
from recast.geometry import se2

NUPLAN_LIMITS: Mapping[str, tuple[float, float]] = {
    "lon_accel": (-4.05, 2.40),
    "lon_jerk": (-4.13, 4.13),
    "yaw_rate": (-0.95, 0.95),
    "yaw_accel": (-1.93, 1.93),
    "lat_accel": (-4.89, 4.89),
    "jerk": (-8.37, 8.37),
}
"""m/s^2, m/s^3, rad/s, rad/s^2, m/s^2, m/s^3; "jerk" is the rate of the acceleration's
magnitude."""
PLAN_LIMITS: Mapping[str, tuple[float, float]] = {
    **{name: limits for name, limits in NUPLAN_LIMITS.items() if name != "jerk"},
    "lon_jerk": (-8.37, 8.37),
}
"""HUGSIM's five checks of a plan, those of the metric COM: m/s^2, m/s^3, rad/s, rad/s^2, m/s^2."""
_STANDING = 1.0
"""Metres: a plan that ends nearer than this to its start has no meaningful heading."""


def savgol_signals(
    lon_accel: ArrayLike,
    lat_accel: ArrayLike,
    magnitude: ArrayLike,
    heading: ArrayLike,
    dt: float,
    *,
    whole_window: bool = False,
    yaw_accel_order: int = 3,
) -> dict[str, Array]:
    """nuPlan's smoothed comfort signals of trajectories, all (..., N).

    Savitzky-Golay, order 2: accelerations over 8 samples, their derivatives over 15; yaw rate over
    5. Yaw acceleration: order 3 over 5. The 15 that nuPlan's signature names for the yaw signals is
    never passed on. Needs N >= 15.

    Args:
        lon_accel, lat_accel, magnitude: (..., N) m/s^2.
        heading: (..., N) radians, unwrapped here.
        dt: seconds per sample.
        whole_window: tuplan_garage's slip: the accelerations and then the derivatives (of
            accelerations smoothed over 8) over all N samples, so that little but trends remains.
        yaw_accel_order: order of the yaw acceleration's polynomial; 2 where NAVSIM compares plans.
    """
    heading = np.unwrap(np.asarray(heading, np.float64), axis=-1)
    samples = heading.shape[-1]
    acceleration_window, jerk_window = (samples, samples) if whole_window else (8, 15)

    def smooth(values: ArrayLike, window: int, order: int = 2, derivative: int = 0) -> Array:
        values = np.asarray(values, np.float64)
        return values @ _savgol_matrix(values.shape[-1], window, order, derivative, dt)

    return {
        "lon_accel": smooth(lon_accel, acceleration_window),
        "lon_jerk": smooth(smooth(lon_accel, 8), jerk_window, derivative=1),
        "yaw_rate": smooth(heading, 5, derivative=1),
        "yaw_accel": smooth(heading, 5, order=yaw_accel_order, derivative=2),
        "lat_accel": smooth(lat_accel, acceleration_window),
        "jerk": smooth(smooth(magnitude, 8), jerk_window, derivative=1),
    }


@lru_cache(maxsize=64)
def _savgol_matrix(samples: int, window: int, order: int, derivative: int, dt: float) -> Array:
    """(N, N): what each sample adds to each smoothed one; the filter is linear, ends included."""
    from scipy.signal import savgol_filter  # half a second, which most commands need not wait

    unit = np.eye(samples)
    return np.asarray(savgol_filter(unit, window, order, deriv=derivative, delta=dt), np.float64)


def check(
    signals: Mapping[str, Array], limits: Mapping[str, tuple[float, float]], *, strict: bool
) -> BoolArray:
    """Which checks hold throughout: (..., number of limits), in the order of `limits`.

    Args:
        signals: (..., any length) signals by name.
        strict: whether a value on the limit fails, as in nuPlan.
    """
    passed: list[BoolArray] = []
    for name, (low, high) in limits.items():
        value = signals[name]
        inside = (low < value) & (value < high) if strict else (low <= value) & (value <= high)
        passed.append(np.asarray(np.all(inside, axis=-1)))
    return np.stack(passed, axis=-1)


def plan_signals(predictions: ArrayLike, dt: float = 0.1) -> dict[str, Array]:
    """Finite differences of plans (..., 40, 3), the origin put in front (HUGSIM's reading).

    Speed is the displacement over dt, acceleration and jerk its differences; yaw rate and
    acceleration the differences of the heading; lateral acceleration speed times yaw rate. The
    headings of a plan that ends within 1 m of its start count as 0.

    Returns:
        signals by name of the check: (..., 40) and shorter, SI units.
    """
    plan = np.asarray(predictions, np.float64)
    plan = np.concatenate([np.zeros_like(plan[..., :1, :]), plan], axis=-2)
    standing = np.hypot(plan[..., -1, 0], plan[..., -1, 1]) < _STANDING
    heading = np.where(standing[..., None], 0.0, plan[..., 2])
    speed = np.linalg.norm(np.diff(plan[..., :2], axis=-2), axis=-1) / dt
    acceleration = np.diff(speed, axis=-1) / dt
    yaw_rate = se2.wrap_angle(np.diff(heading, axis=-1)) / dt
    return {
        "lon_accel": acceleration,
        "lon_jerk": np.diff(acceleration, axis=-1) / dt,
        "yaw_rate": yaw_rate,
        "yaw_accel": np.diff(yaw_rate, axis=-1) / dt,
        "lat_accel": speed * yaw_rate,
    }


def comfortable_plans(predictions: ArrayLike, dt: float = 0.1) -> BoolArray:
    """Which plans (..., 40, 3) pass all five checks of `PLAN_LIMITS`: (...) bool.

    COM is the share of such plans. It depends on a plan alone, not on the ego's speed.
    """
    passed = check(plan_signals(predictions, dt), PLAN_LIMITS, strict=False)
    return np.asarray(passed.all(axis=-1))
