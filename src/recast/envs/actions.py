"""Actions of the environment: waypoints, or acceleration and steering rate."""

from __future__ import annotations

from typing import Literal, cast

import numpy as np
from gymnasium import spaces
from numpy.typing import NDArray

from recast.dynamics import BicycleModel, VehicleParameters
from recast.dynamics import state as ego
from recast.errors import InputError
from recast.geometry import se2
from recast.planning import WAYPOINTS, Plan

Array = NDArray[np.float64]

ActionKind = Literal["waypoints", "controls"]
KINDS = ("waypoints", "controls")

_LOW = np.array([-4.05, -0.5], np.float32)
_HIGH = np.array([2.4, 0.5], np.float32)
_MODEL = BicycleModel()


def action_space(kind: ActionKind) -> spaces.Space[NDArray[np.float32]]:
    """Waypoints (40, 3) as in `Plan`, or acceleration in m/s^2 and steering rate in rad/s (2,)."""
    if kind == "waypoints":
        box = spaces.Box(-np.inf, np.inf, (WAYPOINTS, 3), np.float32)
    else:
        box = spaces.Box(_LOW, _HIGH, (2,), np.float32)
    return cast("spaces.Space[NDArray[np.float32]]", box)


def checked_action(action: object, kind: ActionKind) -> Array:
    """An action as float64, controls clipped to their range.

    Raises:
        InputError: it is no array of finite numbers of the right shape.
    """
    shape = (WAYPOINTS, 3) if kind == "waypoints" else (2,)
    mend = f"give {kind} {shape}, see DrivingEnv.action_space"
    try:
        values = np.asarray(action, np.float64)
    except (TypeError, ValueError):
        raise InputError("DrivingEnv", "action", "is no array of numbers", mend) from None
    if values.shape != shape:
        raise InputError("DrivingEnv", "action", f"has the shape {values.shape}", mend)
    if not np.isfinite(values).all():
        at = np.argwhere(~np.isfinite(values))[0].tolist()
        raise InputError("DrivingEnv", "action", f"is NaN or infinite at {at}", mend)
    return values if kind == "waypoints" else np.clip(values, _LOW, _HIGH)


class HeldControls:
    """An ego controller that holds one acceleration and steering rate, whatever the plan says.

    The kinematic bicycle has the actuator lag of the LQR controller's and never drives backwards.

    Attributes:
        command: (2,) acceleration in m/s^2 and steering rate in rad/s.
    """

    def __init__(self) -> None:
        self.command: Array = np.zeros(2)

    def execute(
        self, state: Array, waypoints: Array, steps: int, vehicle: VehicleParameters, dt: float
    ) -> Array:
        """Ego states (steps + 1, 11), the given one first."""
        states = [np.asarray(state, np.float64)]
        for _ in range(steps):
            new = _MODEL.step(states[-1], self.command, vehicle, dt)
            if new[ego.VX] < 0.0:
                new[[ego.VX, ego.AX, ego.ANGULAR_VELOCITY, ego.ANGULAR_ACCELERATION]] = 0.0
            states.append(new)
        return np.array(states)

    def plan(self, state: Array, vehicle: VehicleParameters, dt: float) -> Plan:
        """Where the command leads within the horizon of a plan: for metrics that look ahead."""
        states = self.execute(state, np.zeros((WAYPOINTS, 3)), WAYPOINTS, vehicle, dt)
        return Plan(se2.relative(states[0, ego.POSE], states[1:, ego.POSE]))
