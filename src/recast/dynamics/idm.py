"""The intelligent driver model (Treiber et al. 2000), behind a lead and on a free road."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import ArrayLike

from recast.arrays import Array


@dataclass(frozen=True)
class IdmParameters:
    """How a driver follows.

    Attributes:
        min_gap: bumper to bumper at a standstill, s0, metres.
        headway: desired time behind the lead, T, seconds.
        max_acceleration: a, m/s^2.
        max_deceleration: comfortable braking, b, m/s^2, positive; also the largest one unless
            `emergency_deceleration` is given.
        exponent: delta of the free-road term.
        emergency_deceleration: largest braking, m/s^2; None for `max_deceleration`.
    """

    min_gap: float = 1.0
    headway: float = 1.5
    max_acceleration: float = 1.0
    max_deceleration: float = 3.0
    exponent: float = 4.0
    emergency_deceleration: float | None = None

    @property
    def hardest(self) -> float:
        """Largest braking, m/s^2."""
        emergency = self.emergency_deceleration
        return self.max_deceleration if emergency is None else emergency


NUPLAN_PLANNER = IdmParameters(max_acceleration=1.0, max_deceleration=3.0)
PDM_BATCH = IdmParameters(max_acceleration=1.5, max_deceleration=3.0, exponent=10.0)
HUGSIM = IdmParameters(min_gap=5.0, headway=2.0, max_acceleration=2.0, max_deceleration=4.0)
ACTOR = IdmParameters(max_acceleration=1.5, max_deceleration=2.5)
"""The scripted actor of a scenario: driven free-road, so gap and headway are unused."""

_STANDSTILL_TARGET = 0.1
"""Target speed in m/s below which the free-road driver simply brakes to a stop."""
_STOP_ONSET = 0.6
"""Share of the largest braking at which braking for a stop point begins."""


def idm_acceleration(
    speed: ArrayLike,
    target_speed: ArrayLike,
    gap: ArrayLike,
    lead_speed: ArrayLike,
    parameters: IdmParameters = NUPLAN_PLANNER,
) -> Array:
    """Accelerations (...) in m/s^2 behind a lead.

    a (1 - (v / v_d)^delta - (s* / s)^2) with s* = s0 + v T + v (v - v_lead) / (2 sqrt(a b)),
    limited to [-hardest braking, a]; gaps below s0 count as s0.

    Args:
        speed, target_speed, lead_speed: (...) m/s, target positive.
        gap: (...) metres from bumper to bumper.
    """
    speed = np.asarray(speed, np.float64)
    a, b = parameters.max_acceleration, parameters.max_deceleration
    desired = (
        parameters.min_gap
        + speed * parameters.headway
        + speed * (speed - np.asarray(lead_speed, np.float64)) / (2 * np.sqrt(a * b))
    )
    gap = np.maximum(np.asarray(gap, np.float64), parameters.min_gap)
    free = (speed / np.asarray(target_speed, np.float64)) ** parameters.exponent
    return np.clip(a * (1 - free - (desired / gap) ** 2), -parameters.hardest, a)


def idm_step(
    state: ArrayLike,
    lead: ArrayLike,
    target_speed: ArrayLike,
    parameters: IdmParameters = NUPLAN_PLANNER,
    dt: float = 0.1,
) -> Array:
    """Advance states (..., 2) = (progress, speed) behind leads (..., 3) by forward Euler.

    Args:
        state: (..., 2) metres along the path and m/s.
        lead: (..., 3) progress of the lead, its speed, and the length to take off the gap (for a
            lead given by its centre, half its length).
        target_speed: (...) m/s.
    """
    state, lead = np.asarray(state, np.float64), np.asarray(lead, np.float64)
    progress, speed = state[..., 0], state[..., 1]
    gap = lead[..., 0] - progress - lead[..., 2]
    acceleration = idm_acceleration(speed, target_speed, gap, lead[..., 1], parameters)
    return np.stack([progress + speed * dt, speed + acceleration * dt], axis=-1)


def free_road_acceleration(
    speed: ArrayLike,
    target_speed: ArrayLike,
    stop_distance: ArrayLike = np.inf,
    parameters: IdmParameters = ACTOR,
) -> Array:
    """Accelerations (...) in m/s^2 without a lead, braking for a stop point ahead.

    a (1 - (v / v_d)^delta) limited to [-b, a]; -b for targets below 0.1 m/s. Once stopping at the
    point needs v^2 / (2 d) >= 0.6 b, at least that deceleration is applied; it only grows from then
    on under forward Euler, so the braking never lets go.

    Args:
        speed, target_speed: (...) m/s.
        stop_distance: (...) metres to the stop point, infinite for none.
    """
    speed = np.asarray(speed, np.float64)
    target, distance = np.asarray(target_speed, np.float64), np.asarray(stop_distance, np.float64)
    a, b = parameters.max_acceleration, parameters.max_deceleration
    standing = target < _STANDSTILL_TARGET
    free = (speed / np.where(standing, 1.0, target)) ** parameters.exponent
    acceleration = np.where(standing, -b, np.clip(a * (1 - free), -b, a))
    needed = speed**2 / (2 * np.maximum(distance, 1e-9))
    return np.where(needed >= _STOP_ONSET * b, np.minimum(acceleration, -needed), acceleration)


def free_road_step(
    state: ArrayLike,
    target_speed: ArrayLike,
    stop_progress: ArrayLike = np.inf,
    parameters: IdmParameters = ACTOR,
    dt: float = 0.1,
) -> Array:
    """Advance states (..., 2) = (progress, speed) on a free road by forward Euler.

    Speed never falls below zero, and the stop point is never passed: there the speed becomes zero
    and the state stays.

    Args:
        state: (..., 2) metres along the path and m/s.
        target_speed: (...) m/s.
        stop_progress: (...) progress of the stop point in metres, infinite for none.
    """
    state = np.asarray(state, np.float64)
    progress, speed = state[..., 0], state[..., 1]
    stop = np.asarray(stop_progress, np.float64)
    acceleration = free_road_acceleration(speed, target_speed, stop - progress, parameters)
    moved = np.minimum(progress + speed * dt, np.maximum(stop, progress))
    faster = np.where(moved >= stop, 0.0, np.maximum(speed + acceleration * dt, 0.0))
    return np.stack([moved, faster], axis=-1)
