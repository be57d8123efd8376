"""The emergency brake: a straight plan where even the best proposal is about to collide."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from recast.dynamics import state as ego
from recast.geometry import se2

Array = NDArray[np.float64]

_MAX_SPEED = 5.0
_MAX_TIME = 2.0
_MIN_ACCELERATION, _MAX_ACCELERATION = -4.05, 2.4
_CRAWL = 0.2


def brakes(speed: float, collision_time: float) -> bool:
    """Whether to brake: at 5 m/s or less, within 2 s of the best proposal's at-fault collision."""
    return speed <= _MAX_SPEED and collision_time <= _MAX_TIME


def brake_plan(state: Array, steps: int, dt: float, *, reference_quirks: bool) -> Array:
    """Poses (steps + 1, 3) straight ahead at a constant speed near zero.

    From the speed v, at more than 0.2 m/s: 1.1 (v + clip(-10 v, -4.05, 2.4)), else, with the
    acceleration a, clip(-4 v - a, -4.05, 2.4). Below 4.05 m/s the former is negative: the
    reference creeps backwards. With quirks off, speeds below zero are 0, and so is all of the
    latter, which would start a standing ego that has just braked.

    Args:
        state: (11,) of the ego.
    """
    speed, acceleration = float(state[ego.VX]), float(state[ego.AX])
    if speed > _CRAWL:
        change = np.clip(-10.0 * speed, _MIN_ACCELERATION, _MAX_ACCELERATION)
        target = 1.1 * (speed + change)
    else:
        target = np.clip(-4.0 * speed - acceleration, _MIN_ACCELERATION, _MAX_ACCELERATION)
    if not reference_quirks:
        target = max(target, 0.0) if speed > _CRAWL else 0.0
    ahead = np.zeros((steps + 1, 3))
    ahead[:, 0] = target * dt * np.arange(steps + 1)
    return se2.compose(state[ego.POSE], ahead)
