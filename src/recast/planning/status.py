"""The eight numbers about the ego that planners trained on OpenScene are told."""

from __future__ import annotations

import numpy as np
from numpy.typing import ArrayLike, NDArray

from recast.dynamics import state as ego
from recast.planning.route import DrivingCommand

COMMANDS = (
    DrivingCommand.LEFT,
    DrivingCommand.STRAIGHT,
    DrivingCommand.RIGHT,
    DrivingCommand.UNKNOWN,
)
"""Order of the one-hot driving command."""


def ego_status(command: DrivingCommand, state: ArrayLike) -> NDArray[np.float32]:
    """(8,) float32: left, straight, right, unknown, vx, vy, ax, ay.

    Ego frame, rear axle, m/s and m/s^2. As the simulator moves without slip, vy is 0 and ay the
    centripetal acceleration, speed times yaw rate, which the logs that the released models were
    trained on contain and the kinematic state does not.

    Args:
        command: see `ReferenceRoute.command`.
        state: (11,) ego state, columns of `recast.dynamics.state`.
    """
    state = np.asarray(state, np.float64)
    speed = state[ego.VX]
    motion = (speed, 0.0, state[ego.AX], speed * state[ego.ANGULAR_VELOCITY])
    return np.array([*(command == known for known in COMMANDS), *motion], np.float32)
