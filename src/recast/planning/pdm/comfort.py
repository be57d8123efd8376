"""nuPlan's comfort checks on simulated states."""

from __future__ import annotations

import numpy as np
from numpy.typing import ArrayLike, NDArray

from recast.dynamics import state as ego
from recast.dynamics.comfort import NUPLAN_LIMITS, check, savgol_signals

Array = NDArray[np.float64]


def comfort_signals(
    states: ArrayLike, dt: float = 0.1, *, whole_window: bool = False
) -> dict[str, Array]:
    """Smoothed signals (..., T) of states (..., T, 11) at the rear axle, T >= 15.

    Args:
        whole_window: see `savgol_signals`.
    """
    states = np.asarray(states, np.float64)
    lon, lat = states[..., ego.AX], states[..., ego.AY]
    return savgol_signals(
        lon, lat, np.hypot(lon, lat), states[..., ego.HEADING], dt, whole_window=whole_window
    )


def is_comfortable(states: ArrayLike, dt: float = 0.1, *, whole_window: bool = False) -> Array:
    """1 where all six signals of states (..., T, 11) stay strictly within limits, else 0."""
    signals = comfort_signals(states, dt, whole_window=whole_window)
    return np.asarray(check(signals, NUPLAN_LIMITS, strict=True).all(axis=-1), np.float64)
