"""The ego state: eleven columns, rear axle, world frame, in the order of nuPlan and NAVSIM.

Positions and heading are in the world frame; velocity and acceleration are along the vehicle's own
x (forward) and y (left). Units: metres, radians, seconds.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import ArrayLike, NDArray

from recast.dynamics.vehicle import PACIFICA, VehicleParameters
from recast.geometry import se2, se3

Array = NDArray[np.float64]

X, Y, HEADING = 0, 1, 2
VX, VY = 3, 4
AX, AY = 5, 6
STEERING_ANGLE, STEERING_RATE = 7, 8
ANGULAR_VELOCITY, ANGULAR_ACCELERATION = 9, 10

POSE = slice(X, HEADING + 1)
"""Columns of the planar pose (x, y, heading)."""

COLUMNS = (
    "x",
    "y",
    "heading",
    "vx",
    "vy",
    "ax",
    "ay",
    "steering_angle",
    "steering_rate",
    "angular_velocity",
    "angular_acceleration",
)
SIZE = len(COLUMNS)

_CRAWL = 0.5
"""Speed in m/s below which steering cannot be told from the yaw rate."""


def make_state(
    pose: ArrayLike,
    speed: ArrayLike = 0.0,
    acceleration: ArrayLike = 0.0,
    angular_velocity: ArrayLike = 0.0,
    vehicle: VehicleParameters = PACIFICA,
) -> Array:
    """States (..., 11) moving forward, with the steering angle that the yaw rate implies.

    Args:
        pose: (..., 3) x, y, heading of the rear axle in the world.
        speed, acceleration: (...) along the heading, m/s and m/s^2.
        angular_velocity: (...) rad/s.
        vehicle: gives the wheelbase L of steering = atan(L * yaw rate / speed), 0 below 0.5 m/s.
    """
    pose = np.asarray(pose, np.float64)
    state = np.zeros((*pose.shape[:-1], SIZE))
    state[..., POSE] = pose
    state[..., VX], state[..., AX] = speed, acceleration
    state[..., ANGULAR_VELOCITY] = angular_velocity
    fast = np.abs(state[..., VX]) >= _CRAWL
    curvature = state[..., ANGULAR_VELOCITY] / np.where(fast, state[..., VX], 1.0)
    state[..., STEERING_ANGLE] = np.where(fast, np.arctan(vehicle.wheelbase * curvature), 0.0)
    return state


def initial_state(
    timestamps_us: ArrayLike,
    world_from_rig: ArrayLike,
    timestamp_us: int,
    vehicle: VehicleParameters = PACIFICA,
    dt: float = 0.1,
) -> Array:
    """The state (11,) of a logged trajectory at one time.

    Speed is the central difference of the positions at a spacing of `dt`, taken along the heading;
    acceleration and yaw rate likewise. Near the ends of the log the differences are one-sided.

    Args:
        timestamps_us: (T,) int64 microseconds, strictly increasing.
        world_from_rig: (T, 4, 4).
        timestamp_us: within the recorded interval.

    Raises:
        ValueError: the time lies outside the log, or less than `dt` is recorded around it.
    """
    times = np.asarray(timestamps_us, np.int64)
    step = round(dt * 1e6)
    before = int(min(2, (timestamp_us - times[0]) // step))
    after = int(min(2, (times[-1] - timestamp_us) // step))
    query = timestamp_us + step * np.arange(-before, after + 1)
    matrices = se3.interpolate(times, world_from_rig, query)
    if len(query) < 2:
        raise ValueError(f"initial_state: the log holds less than {dt} s around {timestamp_us} us")
    poses = se2.from_se3(matrices)
    headings = np.unwrap(poses[:, 2])
    velocity = np.gradient(poses[:, :2], dt, axis=0)
    speeds = velocity[:, 0] * np.cos(headings) + velocity[:, 1] * np.sin(headings)
    return make_state(
        poses[before],
        speeds[before],
        np.gradient(speeds, dt)[before],
        np.gradient(headings, dt)[before],
        vehicle,
    )
