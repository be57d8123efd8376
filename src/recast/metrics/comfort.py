"""COM: share of the plans that are comfortable, in three readings; and nuPlan's comfort of what was
driven."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass

import numpy as np
from numpy.typing import ArrayLike

from recast.arrays import Array, BoolArray
from recast.dynamics import state as ego
from recast.dynamics.comfort import (
    NUPLAN_LIMITS,
    PLAN_LIMITS,
    check,
    plan_signals,
    savgol_signals,
)
from recast.metrics.table import Metric, invalid

LIMITS_4_13: Mapping[str, tuple[float, float]] = {
    name: limits for name, limits in NUPLAN_LIMITS.items() if name != "jerk"
}
"""HUGSIM's five checks with nuPlan's limit on the longitudinal jerk."""
_NUPLAN_DT = 0.1
_WINDOW = 15
"""nuPlan's smoothing counts in samples 0.1 s apart, and its longest window has 15 of them."""
_UNITS = {
    "lon_accel": "m/s^2",
    "lon_jerk": "m/s^3",
    "yaw_rate": "rad/s",
    "yaw_accel": "rad/s^2",
    "lat_accel": "m/s^2",
    "jerk": "m/s^3",
}


@dataclass(frozen=True)
class Comfort:
    """One reading of COM for a rollout.

    Attributes:
        com: share of plans that pass every check.
        checks: names of the checks.
        passed: (C, number of checks) bool; one row for what was driven; none without a value.
    """

    com: Metric
    checks: tuple[str, ...]
    passed: BoolArray

    def failed_checks(self) -> list[list[str]]:
        """Names of the failed checks of each plan."""
        return [
            [name for name, ok in zip(self.checks, row, strict=True) if not ok]
            for row in self.passed
        ]


def plan_savgol_signals(predictions: ArrayLike, dt: float = 0.1) -> dict[str, Array]:
    """nuPlan's smoothing applied to the finite differences of plans (..., 40, 3).

    Accelerations are taken at the 39 inner poses: the lateral one is the mean of its two steps.
    """
    raw = plan_signals(predictions, dt)
    lon, lateral = raw["lon_accel"], raw["lat_accel"]
    lat = (lateral[..., 1:] + lateral[..., :-1]) / 2
    heading = np.cumsum(raw["yaw_rate"], axis=-1) * dt
    heading = np.concatenate([np.zeros_like(heading[..., :1]), heading], axis=-1)
    return savgol_signals(lon, lat, np.hypot(lon, lat), heading, dt)


def com_hugsim(predictions: ArrayLike, dt: float = 0.1) -> Comfort:
    """COM, the headline: five checks on raw finite differences, jerk limit 8.37 m/s^3."""
    return _comfort(predictions, plan_signals, PLAN_LIMITS, dt, strict=False)


def com_4_13(predictions: ArrayLike, dt: float = 0.1) -> Comfort:
    """COM with nuPlan's jerk limit, 4.13 m/s^3, else as `com_hugsim`."""
    return _comfort(predictions, plan_signals, LIMITS_4_13, dt, strict=False)


def com_nuplan_savgol(predictions: ArrayLike, dt: float = 0.1) -> Comfort:
    """COM with nuPlan's six checks and smoothing; no value for other steps than nuPlan's 0.1 s."""
    if abs(dt - _NUPLAN_DT) > 1e-9:
        return _none(_other_steps(dt))
    return _comfort(predictions, plan_savgol_signals, NUPLAN_LIMITS, dt, strict=True)


def driven_signals(states: ArrayLike, dt: float = 0.1) -> dict[str, Array]:
    """nuPlan's smoothed comfort signals (T,) of driven states (T, 11), T >= 15.

    Longitudinal acceleration, yaw rate and heading are those of the rear axle. nuPlan's simulated
    ego has no lateral acceleration, which would make that check idle: here it is v times the yaw
    rate, what a rear axle that does not slip has.
    """
    states = np.asarray(states, np.float64)
    lon = states[..., ego.AX]
    lat = states[..., ego.VX] * states[..., ego.ANGULAR_VELOCITY]
    return savgol_signals(lon, lat, np.hypot(lon, lat), states[..., ego.HEADING], dt)


def com_driven(states: ArrayLike, dt: float = 0.1) -> Comfort:
    """nuPlan's comfort of the motion that was driven: 1 iff its six checks hold throughout, else 0.

    Finer steps are thinned to nuPlan's 0.1 s; there is no value where that cannot be, or for less
    than 15 states.

    Args:
        states: (S+1, 11) states of the ego.
        dt: seconds between states.
    """
    every = max(1, round(_NUPLAN_DT / dt))
    if abs(every * dt - _NUPLAN_DT) > 1e-9:
        return _none(_other_steps(dt))
    states = np.asarray(states, np.float64)[::every]
    if len(states) < _WINDOW:
        seconds = _NUPLAN_DT * (_WINDOW - 1)
        return _none(f"nuPlan's smoothing needs a drive of {seconds:.1f} s or more")
    signals = driven_signals(states, _NUPLAN_DT)
    passed = check(signals, NUPLAN_LIMITS, strict=True)
    failed = [name for name, ok in zip(NUPLAN_LIMITS, passed, strict=True) if not ok]
    reason = "; ".join(_worst(name, signals[name]) for name in failed) or None
    return Comfort(Metric(float(not failed), reason), tuple(NUPLAN_LIMITS), passed[None])


def _worst(name: str, values: Array) -> str:
    """Where a signal leaves its limits furthest, in words."""
    low, high = NUPLAN_LIMITS[name]
    step = int(np.argmax(np.maximum(low - values, values - high)))
    at = step * _NUPLAN_DT
    return f"{name} is {values[step]:.2f} {_UNITS[name]} at {at:.1f} s ({low:g} to {high:g})"


def _other_steps(dt: float) -> str:
    return f"nuPlan's smoothing needs steps of {_NUPLAN_DT} s, but the drive has steps of {dt:g} s"


def _none(reason: str, names: tuple[str, ...] = tuple(NUPLAN_LIMITS)) -> Comfort:
    return Comfort(invalid(reason), names, np.zeros((0, len(names)), np.bool_))


def _comfort(
    predictions: ArrayLike,
    signals: Callable[[ArrayLike, float], dict[str, Array]],
    limits: Mapping[str, tuple[float, float]],
    dt: float,
    *,
    strict: bool,
) -> Comfort:
    names = tuple(limits)
    predictions = np.asarray(predictions, np.float64)
    if len(predictions) == 0:
        return _none("no plan was made", names)
    passed = check(signals(predictions, dt), limits, strict=strict)
    good = np.asarray(passed.all(axis=-1))
    reason = None
    if not good.all():
        counts = {n: int(c) for n, c in zip(names, (~passed).sum(axis=0), strict=True) if c}
        listed = ", ".join(f"{name} in {count}" for name, count in counts.items())
        reason = f"{int((~good).sum())} of {len(good)} plans fail: {listed}"
    return Comfort(Metric(float(good.mean()), reason), names, passed)
