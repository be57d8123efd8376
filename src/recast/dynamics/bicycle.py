"""Kinematic bicycle model at the rear axle, with first-order actuators."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import ArrayLike, NDArray

from recast.dynamics import state as ego
from recast.dynamics.vehicle import PACIFICA, VehicleParameters
from recast.geometry import se2

Array = NDArray[np.float64]


@dataclass(frozen=True)
class BicycleModel:
    """Actuators; which vehicle they move is told at each step.

    Attributes:
        accel_time_constant: lag of the acceleration behind its command, seconds; 0 for none.
        steering_time_constant: lag of the steering angle, seconds; 0 for none.
        max_steering_angle: radians.
    """

    accel_time_constant: float = 0.2
    steering_time_constant: float = 0.05
    max_steering_angle: float = np.pi / 3

    def step(
        self,
        state: ArrayLike,
        command: ArrayLike,
        vehicle: VehicleParameters = PACIFICA,
        dt: float = 0.1,
    ) -> Array:
        """Advance states (..., 11) by `dt` seconds under commands (..., 2).

        The pose moves with the old speed and steering angle (forward Euler); speed may go negative.
        Source: nuPlan's KinematicBicycleModel, same order of updates.

        Args:
            state: (..., 11), columns of `recast.dynamics.state`.
            command: (..., 2) acceleration in m/s^2 and steering rate in rad/s.
            vehicle: gives the wheelbase.
        """
        old, command = np.asarray(state, np.float64), np.asarray(command, np.float64)
        speed, heading = old[..., ego.VX], old[..., ego.HEADING]
        steering = old[..., ego.STEERING_ANGLE]

        accel_gain = dt / (dt + self.accel_time_constant)
        acceleration = old[..., ego.AX] + accel_gain * (command[..., 0] - old[..., ego.AX])
        steering_gain = dt / (dt + self.steering_time_constant)
        target = steering + steering_gain * (command[..., 1] * dt)
        rate = (target - steering) / dt

        limit = self.max_steering_angle
        batch = np.broadcast_shapes(old.shape[:-1], command.shape[:-1])
        new = np.zeros((*batch, ego.SIZE))
        new[..., ego.X] = old[..., ego.X] + speed * np.cos(heading) * dt
        new[..., ego.Y] = old[..., ego.Y] + speed * np.sin(heading) * dt
        turn = speed * np.tan(steering) / vehicle.wheelbase * dt
        new[..., ego.HEADING] = se2.wrap_angle(heading + turn)
        new[..., ego.VX] = speed + acceleration * dt
        new[..., ego.AX] = acceleration
        new[..., ego.STEERING_ANGLE] = np.clip(steering + rate * dt, -limit, limit)
        new[..., ego.STEERING_RATE] = rate
        new[..., ego.ANGULAR_VELOCITY] = (
            new[..., ego.VX] * np.tan(new[..., ego.STEERING_ANGLE]) / vehicle.wheelbase
        )
        new[..., ego.ANGULAR_ACCELERATION] = (
            new[..., ego.ANGULAR_VELOCITY] - old[..., ego.ANGULAR_VELOCITY]
        ) / dt
        return new
