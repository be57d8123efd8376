"""Executing a plan: fit its profiles once, then LQR and bicycle step by step."""

from __future__ import annotations

from dataclasses import dataclass, field

import numpy as np
from numpy.typing import ArrayLike, NDArray

from recast.dynamics import state as ego
from recast.dynamics.bicycle import BicycleModel
from recast.dynamics.lqr import LqrWeights, lqr_command
from recast.dynamics.profiles import ProfileWeights, fit_profile
from recast.dynamics.vehicle import PACIFICA, VehicleParameters
from recast.geometry import se2

Array = NDArray[np.float64]


@dataclass(frozen=True)
class TrackerConfig:
    """How a plan is followed; vehicle and time step are the rollout's and told to `track`."""

    model: BicycleModel = field(default_factory=BicycleModel)
    lqr: LqrWeights = field(default_factory=LqrWeights)
    profile: ProfileWeights = field(default_factory=ProfileWeights)


DEFAULT = TrackerConfig()
"""nuPlan's tracker."""

PDM_REFERENCE = TrackerConfig(profile=ProfileWeights(jerk_matrix="reference"))
"""The tracker inside PDM-Closed and NAVSIM, with their jerk matrix."""

NEURONCAP = TrackerConfig(
    model=BicycleModel(accel_time_constant=0.0, steering_time_constant=0.0),
    lqr=LqrWeights(
        q_lateral=(20.0, 0.0, 0.0),
        r_lateral=0.05,
        stopping_gain=1.5,
        stopping_velocity=0.5,
        max_acceleration=6.0,
    ),
    profile=ProfileWeights(jerk=1e-6, curvature_rate=1e-5),
)
"""NeuroNCAP's tuning: immediate actuators, tight lateral tracking, bounded acceleration."""

PRESETS = {"default": DEFAULT, "pdm_reference": PDM_REFERENCE, "neuroncap": NEURONCAP}


def plan_to_poses(ego_pose: ArrayLike, waypoints: ArrayLike) -> Array:
    """World poses (..., W + 1, 3) of waypoints (..., W, 3) in the ego frame, the ego pose first."""
    start = np.asarray(ego_pose, np.float64)[..., None, :]
    return np.concatenate([start, se2.compose(start, waypoints)], axis=-2)


def track(
    state: ArrayLike,
    poses: ArrayLike,
    steps: int,
    config: TrackerConfig = DEFAULT,
    vehicle: VehicleParameters = PACIFICA,
    dt: float = 0.1,
) -> Array:
    """Follow reference poses for some steps.

    Args:
        state: (..., 11) at the time of `poses[..., 0, :]`; acceleration, steering angle and yaw
            rate carry over into the motion.
        poses: (..., M + 1, 3) world poses of the rear axle, `dt` seconds apart.
        steps: 1 to M, of `dt` seconds.
        vehicle: gives the wheelbase.

    Returns:
        (..., steps + 1, 11), the given state first.

    Raises:
        ValueError: more steps than poses, or poses that cannot be fitted.
    """
    poses = np.asarray(poses, np.float64)
    _check_steps(poses, steps)
    profile = fit_profile(poses, dt, config.profile)
    states = [np.asarray(state, np.float64)]
    for index in range(steps):
        command = lqr_command(states[-1], poses, profile, index, config.lqr, vehicle, dt)
        states.append(config.model.step(states[-1], command, vehicle, dt))
    return np.stack(states, axis=-2)


def follow_perfectly(
    state: ArrayLike,
    poses: ArrayLike,
    steps: int,
    vehicle: VehicleParameters = PACIFICA,
    dt: float = 0.1,
) -> Array:
    """Like `track`, but the vehicle is put onto the reference poses: a debugging aid."""
    poses, state = np.asarray(poses, np.float64), np.asarray(state, np.float64)
    _check_steps(poses, steps)
    chosen = poses[..., : steps + 1, :]
    moved = np.diff(chosen[..., :2], axis=-2)
    heading = chosen[..., :-1, 2]
    speed = (moved[..., 0] * np.cos(heading) + moved[..., 1] * np.sin(heading)) / dt
    before = np.concatenate([state[..., None, ego.VX], speed[..., :-1]], axis=-1)
    turn_rate = se2.wrap_angle(np.diff(chosen[..., 2], axis=-1)) / dt
    followed = ego.make_state(chosen[..., 1:, :], speed, (speed - before) / dt, turn_rate, vehicle)
    return np.concatenate([state[..., None, :], followed], axis=-2)


def _check_steps(poses: Array, steps: int) -> None:
    if not 1 <= steps <= poses.shape[-2] - 1:
        raise ValueError(f"steps: {steps} asked of a plan of {poses.shape[-2] - 1}")
