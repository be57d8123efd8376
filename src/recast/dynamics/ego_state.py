"""The ego state with names: eleven numbers that are an array and have fields."""

from __future__ import annotations

from typing import Any, Self

import numpy as np
from numpy.typing import ArrayLike, NDArray

from recast.dynamics import state

Array = NDArray[np.float64]


class EgoState(np.ndarray[tuple[int], np.dtype[np.float64]]):
    """One state of the ego: rear axle; pose in the world, the rest in the ego frame; SI units.

    It is an array (11,) float64 with the columns of `recast.dynamics.state`, so `state[VX]` and
    `np.asarray(state)` work as with any array. It holds a copy of its values: who writes into it
    does not change the simulation. Slices and results of arithmetic are plain arrays.

    Args:
        values: (11,) numbers.

    Raises:
        ValueError: `values` has another shape.
    """

    def __new__(cls, values: ArrayLike) -> Self:
        """Copy the values."""
        array = np.array(values, np.float64)
        if array.shape != (state.SIZE,):
            raise ValueError(f"EgoState: expected ({state.SIZE},), got {array.shape}")
        return array.view(cls)

    def __getitem__(self, key: Any) -> Any:
        return np.asarray(self)[key]

    def __array_wrap__(self, array: Any, context: Any = None, return_scalar: bool = False) -> Any:
        plain = np.asarray(array)
        return plain[()] if return_scalar else plain

    @property
    def x(self) -> float:
        """Metres, world."""
        return float(self[state.X])

    @property
    def y(self) -> float:
        """Metres, world."""
        return float(self[state.Y])

    @property
    def heading(self) -> float:
        """Radians, world, counter-clockwise from the x axis."""
        return float(self[state.HEADING])

    @property
    def vx(self) -> float:
        """Velocity along the heading, m/s."""
        return float(self[state.VX])

    @property
    def vy(self) -> float:
        """Velocity to the left, m/s."""
        return float(self[state.VY])

    @property
    def ax(self) -> float:
        """Acceleration along the heading, m/s^2."""
        return float(self[state.AX])

    @property
    def ay(self) -> float:
        """Acceleration to the left, m/s^2."""
        return float(self[state.AY])

    @property
    def steering_angle(self) -> float:
        """Radians, left positive."""
        return float(self[state.STEERING_ANGLE])

    @property
    def steering_rate(self) -> float:
        """Radians per second."""
        return float(self[state.STEERING_RATE])

    @property
    def angular_velocity(self) -> float:
        """Yaw rate, rad/s."""
        return float(self[state.ANGULAR_VELOCITY])

    @property
    def angular_acceleration(self) -> float:
        """rad/s^2."""
        return float(self[state.ANGULAR_ACCELERATION])

    @property
    def pose(self) -> Array:
        """(3,) x, y, heading of the rear axle, world."""
        pose: Array = self[state.POSE]
        return pose

    @property
    def speed(self) -> float:
        """Length of the velocity, m/s."""
        return float(np.hypot(self[state.VX], self[state.VY]))
