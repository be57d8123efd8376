"""One-step LQR that steers towards a point a horizon ahead on a reference profile."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import ArrayLike, NDArray

from recast.dynamics import state as ego
from recast.dynamics.profiles import Profile
from recast.dynamics.vehicle import PACIFICA, VehicleParameters
from recast.geometry import se2

Array = NDArray[np.float64]


@dataclass(frozen=True)
class LqrWeights:
    """Costs and horizon of the tracker.

    Attributes:
        q_longitudinal, r_longitudinal: cost of speed error and of acceleration.
        q_lateral: cost of lateral error (m), heading error and steering angle (rad).
        r_lateral: cost of the steering rate.
        horizon: seconds looked ahead, at least one step.
        stopping_gain: proportional gain of the speed error while stopping, 1/s.
        stopping_velocity: m/s; at or below it, both in the reference and in the state, the vehicle
            stops without steering.
        max_acceleration: magnitude limit of the command in m/s^2, or None.
    """

    q_longitudinal: float = 10.0
    r_longitudinal: float = 1.0
    q_lateral: tuple[float, float, float] = (1.0, 10.0, 0.0)
    r_lateral: float = 1.0
    horizon: float = 1.0
    stopping_gain: float = 0.5
    stopping_velocity: float = 0.2
    max_acceleration: float | None = None


def lqr_command(
    state: ArrayLike,
    poses: ArrayLike,
    profile: Profile,
    index: int,
    weights: LqrWeights | None = None,
    vehicle: VehicleParameters = PACIFICA,
    dt: float = 0.1,
) -> Array:
    """Commands (..., 2) = acceleration and steering rate at step `index` of a reference.

    Longitudinal: constant acceleration over the horizon T that minimises q (v + T u - v_ref)^2 +
    r u^2. Lateral: constant steering rate that minimises the cost of the error (lateral, heading,
    steering) after the horizon, with the kinematics linearised at the resulting speeds. Source:
    nuPlan's LQRTracker; no saturation unless asked for.

    Args:
        state: (..., 11) current state.
        poses: (..., M + 1, 3) reference poses.
        profile: of those poses, M values.
        index: which reference pose belongs to the current state, 0 <= index < M.
    """
    weights = weights or LqrWeights()
    state, poses = np.asarray(state, np.float64), np.asarray(poses, np.float64)
    speed = state[..., ego.VX]
    count = profile.velocity.shape[-1]
    steps = max(1, round(weights.horizon / dt))
    ahead = min(index + steps, count - 1)
    reference_speed = profile.velocity[..., ahead]

    span = steps * dt
    gain = (
        weights.q_longitudinal * span / (weights.q_longitudinal * span**2 + weights.r_longitudinal)
    )
    acceleration = -gain * (speed - reference_speed)
    rate = _steering_rate(
        state, poses[..., index, :], acceleration, profile, index, steps, weights, vehicle, dt
    )

    stopping = (reference_speed <= weights.stopping_velocity) & (speed <= weights.stopping_velocity)
    brake = -weights.stopping_gain * (speed - reference_speed)
    acceleration = np.where(stopping, brake, acceleration)
    if weights.max_acceleration is not None:
        acceleration = np.clip(acceleration, -weights.max_acceleration, weights.max_acceleration)
    return np.stack([acceleration, np.where(stopping, 0.0, rate)], axis=-1)


def _steering_rate(
    state: Array,
    pose: Array,
    acceleration: Array,
    profile: Profile,
    index: int,
    steps: int,
    weights: LqrWeights,
    vehicle: VehicleParameters,
    dt: float,
) -> Array:
    offset = state[..., :2] - pose[..., :2]
    sin, cos = np.sin(pose[..., 2]), np.cos(pose[..., 2])
    lateral = -offset[..., 0] * sin + offset[..., 1] * cos
    heading = se2.wrap_angle(state[..., ego.HEADING] - pose[..., 2])
    steering = state[..., ego.STEERING_ANGLE]
    # Carry the error through the horizon without input, and beside it its derivative with respect
    # to the (constant) steering rate.
    d_lateral = d_heading = d_steering = np.zeros_like(lateral)
    last = profile.curvature.shape[-1] - 1
    for k in range(steps):
        speed = state[..., ego.VX] + k * dt * acceleration
        step = speed * dt
        curvature = profile.curvature[..., min(index + k, last)]
        lateral, d_lateral = lateral + step * heading, d_lateral + step * d_heading
        heading = heading + step * (steering / vehicle.wheelbase - curvature)
        d_heading = d_heading + step * d_steering / vehicle.wheelbase
        d_steering = d_steering + dt
    error = (lateral, se2.wrap_angle(heading), se2.wrap_angle(steering))
    derivative = (d_lateral, d_heading, d_steering)
    slope, curve = np.zeros_like(lateral), np.full_like(lateral, weights.r_lateral)
    for q, e, d in zip(weights.q_lateral, error, derivative, strict=True):
        slope, curve = slope + d * q * e, curve + d * q * d
    rate: Array = -slope / curve
    return rate
