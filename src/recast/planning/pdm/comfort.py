"""nuPlan's comfort checks on simulated states."""

from __future__ import annotations

from collections.abc import Mapping

import numpy as np
from numpy.typing import ArrayLike, NDArray
from scipy.signal import savgol_filter

from recast.dynamics import state as ego

Array = NDArray[np.float64]

LIMITS: Mapping[str, tuple[float, float]] = {
    "lon_accel": (-4.05, 2.40),
    "lat_accel": (-4.89, 4.89),
    "jerk": (-8.37, 8.37),
    "lon_jerk": (-4.13, 4.13),
    "yaw_accel": (-1.93, 1.93),
    "yaw_rate": (-0.95, 0.95),
}
"""m/s^2, m/s^3, rad/s^2, rad/s; "jerk" is the rate of the acceleration's magnitude."""


def comfort_signals(
    states: ArrayLike, dt: float = 0.1, *, whole_window: bool = False
) -> dict[str, Array]:
    """Smoothed signals (..., T) of states (..., T, 11) at the rear axle, T >= 15.

    Savitzky-Golay, order 2: accelerations over 8 samples, their derivatives over 15, the yaw rate
    over 5; the yaw acceleration with order 3 over 5.

    Args:
        whole_window: tuplan_garage's slip: the accelerations and then the derivatives (of
            accelerations smoothed over 8) over all T samples, so that little but trends remains.
    """
    states = np.asarray(states, np.float64)
    heading = np.unwrap(states[..., ego.HEADING], axis=-1)
    samples = states.shape[-2]
    acceleration_window, jerk_window = (samples, samples) if whole_window else (8, 15)

    def smooth(values: Array, window: int, order: int = 2, derivative: int = 0) -> Array:
        smoothed = savgol_filter(values, window, order, deriv=derivative, delta=dt, axis=-1)
        return np.asarray(smoothed, np.float64)

    lon, lat = states[..., ego.AX], states[..., ego.AY]
    return {
        "lon_accel": smooth(lon, acceleration_window),
        "lat_accel": smooth(lat, acceleration_window),
        "jerk": smooth(smooth(np.hypot(lon, lat), 8), jerk_window, derivative=1),
        "lon_jerk": smooth(smooth(lon, 8), jerk_window, derivative=1),
        "yaw_accel": smooth(heading, 5, order=3, derivative=2),
        "yaw_rate": smooth(heading, 5, derivative=1),
    }


def is_comfortable(states: ArrayLike, dt: float = 0.1, *, whole_window: bool = False) -> Array:
    """1 where all six signals of states (..., T, 11) stay strictly within `LIMITS`, else 0."""
    signals = comfort_signals(states, dt, whole_window=whole_window)
    good = [
        np.all((low < signals[name]) & (signals[name] < high), axis=-1)
        for name, (low, high) in LIMITS.items()
    ]
    return np.asarray(np.all(good, axis=0), np.float64)
