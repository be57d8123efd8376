"""Executing a plan: profiles fitted once, one-step LQR, kinematic bicycle; checks of comfort."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field
from functools import lru_cache
from typing import Literal

import numpy as np
from numpy.typing import ArrayLike

from recast.arrays import Array, BoolArray
from recast.dynamics import state as ego
from recast.dynamics.state import PACIFICA, VehicleParameters
from recast.geometry import se2

JerkMatrix = Literal["correct", "reference"]

_WEIGHTS_DT = 0.1
"""Seconds between poses for which nuPlan's weights are meant."""


@dataclass(frozen=True)
class Profile:
    """What a pose sequence of M + 1 poses asks of the vehicle.

    Attributes:
        velocity: (..., M) m/s.
        acceleration: (..., M - 1) m/s^2.
        curvature: (..., M) 1/m.
        curvature_rate: (..., M - 1) 1/(m s).
    """

    velocity: Array
    acceleration: Array
    curvature: Array
    curvature_rate: Array


@dataclass(frozen=True)
class ProfileWeights:
    """Regularisation of the fit, as it weighs on poses 0.1 s apart.

    Attributes:
        jerk: weight of squared acceleration differences.
        curvature_rate: weight of squared curvature rates. Other steps scale it with their square,
            so that the same motion is smoothed alike whatever the step; the other two need no such
            scaling.
        initial_curvature: weight of the squared first curvature.
        jerk_matrix: "correct" differences the accelerations, as nuPlan does; "reference" is the
            matrix of NAVSIM and tuplan_garage, which by a slip penalises the accelerations
            themselves. It exists to reproduce their numbers.
    """

    jerk: float = 1e-4
    curvature_rate: float = 1e-2
    initial_curvature: float = 1e-10
    jerk_matrix: JerkMatrix = "correct"


def fit_profile(
    poses: ArrayLike, dt: float = 0.1, weights: ProfileWeights | None = None
) -> Profile:
    """Fit speed and curvature to poses (..., M + 1, 3) that lie `dt` seconds apart, M >= 2.

    Speed minimises |A z - displacement|^2 + jerk |R z|^2 over z = (v_0, a_0, ..., a_{M-2}), where A
    integrates the accelerations and moves along the given headings; curvature likewise over
    (k_0, its rates), from the heading changes and the fitted speed. Both are solved as linear
    systems: pseudo-inverses are unreliable here on standing and constant-speed inputs.

    Source: nuPlan's get_velocity_curvature_profiles_with_derivatives_from_poses.

    Raises:
        ValueError: fewer than three poses.
    """
    weights = weights or ProfileWeights()
    poses = np.asarray(poses, np.float64)
    if poses.ndim < 2 or poses.shape[-2] < 3 or poses.shape[-1] != 3:
        raise ValueError(f"fit_profile: poses (..., M + 1 >= 3, 3) expected, got {poses.shape}")
    count = poses.shape[-2] - 1
    heading = poses[..., :-1, 2]
    displacement = np.diff(poses[..., :2], axis=-2)
    # Rows of A are (cos, sin) times one row of `integrate`: its normal matrix does not depend on
    # the headings, and the data enter as the displacement along the heading.
    along = displacement[..., 0] * np.cos(heading) + displacement[..., 1] * np.sin(heading)
    integrate = _integration_matrix(count, dt)
    difference = _jerk_matrix(count, weights.jerk_matrix)
    normal = integrate.T @ integrate
    normal[1:, 1:] += weights.jerk * difference.T @ difference
    velocity, acceleration = _integrate(_solve(normal, along @ integrate), dt)

    turn = se2.wrap_angle(np.diff(poses[..., 2], axis=-1))
    design = velocity[..., :, None] * integrate
    penalty = np.full(count, weights.curvature_rate * (dt / _WEIGHTS_DT) ** 2)
    penalty[0] = weights.initial_curvature
    normal = np.swapaxes(design, -1, -2) @ design + np.diag(penalty)
    right = np.einsum("...nk,...n->...k", design, turn)
    curvature, curvature_rate = _integrate(_solve(normal, right), dt)
    return Profile(velocity, acceleration, curvature, curvature_rate)


def _integration_matrix(count: int, dt: float) -> Array:
    """(M, M): distance covered in each step by (initial value, rates), all at forward Euler."""
    matrix = dt * dt * np.tri(count)
    matrix[:, 0] = dt
    return matrix


def _jerk_matrix(count: int, kind: JerkMatrix) -> Array:
    """(M - 2, M - 1): see `ProfileWeights.jerk_matrix`."""
    matrix = -np.eye(count - 2, count - 1)
    if kind == "correct":
        matrix += np.eye(count - 2, count - 1, k=1)
    elif count > 2:
        matrix[-1, -1] = 1.0
    return matrix


def _solve(normal: Array, right: Array) -> Array:
    return np.asarray(np.linalg.solve(normal, right[..., None])[..., 0], np.float64)


def _integrate(solution: Array, dt: float) -> tuple[Array, Array]:
    """Values (..., M) and rates (..., M - 1) of solutions (initial value, rates)."""
    first, rates = solution[..., :1], solution[..., 1:]
    values = np.empty_like(solution)
    values[..., :1] = first
    values[..., 1:] = first + np.cumsum(rates * dt, axis=-1)
    return values, rates


@dataclass(frozen=True)
class BicycleModel:
    """Actuators; which vehicle they move is given at each step.

    Attributes:
        accel_time_constant: lag of the acceleration behind its command, seconds; 0 for none.
        steering_time_constant: lag of the steering angle, seconds; 0 for none.
        max_steering_angle: largest steering angle, radians.
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
        profile: profile of those poses, M values.
        index: index of the reference pose that belongs to the current state, 0 <= index < M.
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
    # to the (constant) steering rate: running sums over steps, which are the leading axis.
    horizon = np.arange(steps)
    steady = (steps, *(1,) * lateral.ndim)
    ahead = np.minimum(index + horizon, profile.curvature.shape[-1] - 1)
    curvature = np.moveaxis(profile.curvature[..., ahead], -1, 0)
    step = (state[..., ego.VX] + (horizon * dt).reshape(steady) * acceleration) * dt
    headings = _running(heading, step * (steering / vehicle.wheelbase - curvature))
    lateral = _running(lateral, step * headings[:-1])[-1]
    d_steering = _running(0.0, np.full(steady, dt))
    d_heading = _running(0.0, step * d_steering[:-1] / vehicle.wheelbase)
    d_lateral = _running(0.0, step * d_heading[:-1])[-1]
    heading, d_heading, d_steering = headings[-1], d_heading[-1], d_steering[-1]
    error = (lateral, se2.wrap_angle(heading), se2.wrap_angle(steering))
    derivative = (d_lateral, d_heading, d_steering)
    slope, curve = np.zeros_like(lateral), np.full_like(lateral, weights.r_lateral)
    for q, e, d in zip(weights.q_lateral, error, derivative, strict=True):
        slope, curve = slope + d * q * e, curve + d * q * d
    return -slope / curve


def _running(start: ArrayLike, changes: Array) -> Array:
    """Values (K + 1, ...) from a start (...) on, by changes (K, ...) added one after the other."""
    values = np.empty((len(changes) + 1, *changes.shape[1:]))
    values[0], values[1:] = start, changes
    return np.add.accumulate(values, axis=0)


@dataclass(frozen=True)
class TrackerConfig:
    """How a plan is followed; vehicle and time step are the rollout's, given to `track`."""

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
        state: (..., 11) state at the time of `poses[..., 0, :]`; acceleration, steering angle and
            yaw rate carry over into the motion.
        poses: (..., M + 1, 3) world poses of the rear axle, `dt` seconds apart.
        steps: number of steps of `dt` seconds, 1 to M.
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


NUPLAN_LIMITS: Mapping[str, tuple[float, float]] = {
    "lon_accel": (-4.05, 2.40),
    "lon_jerk": (-4.13, 4.13),
    "yaw_rate": (-0.95, 0.95),
    "yaw_accel": (-1.93, 1.93),
    "lat_accel": (-4.89, 4.89),
    "jerk": (-8.37, 8.37),
}
"""m/s^2, m/s^3, rad/s, rad/s^2, m/s^2, m/s^3; "jerk" is the rate of the acceleration's
magnitude."""
PLAN_LIMITS: Mapping[str, tuple[float, float]] = {
    **{name: limits for name, limits in NUPLAN_LIMITS.items() if name != "jerk"},
    "lon_jerk": (-8.37, 8.37),
}
"""HUGSIM's five checks of a plan, those of the metric COM: m/s^2, m/s^3, rad/s, rad/s^2, m/s^2."""
_STANDING = 1.0
"""Metres: a plan that ends nearer than this to its start has no meaningful heading."""


def savgol_signals(
    lon_accel: ArrayLike,
    lat_accel: ArrayLike,
    magnitude: ArrayLike,
    heading: ArrayLike,
    dt: float,
    *,
    whole_window: bool = False,
    yaw_accel_order: int = 3,
) -> dict[str, Array]:
    """nuPlan's smoothed comfort signals of trajectories, all (..., N).

    Savitzky-Golay, order 2: accelerations over 8 samples, their derivatives over 15; yaw rate over
    5. Yaw acceleration: order 3 over 5. The 15 that nuPlan's signature names for the yaw signals is
    never passed on. Needs N >= 15.

    Args:
        lon_accel, lat_accel, magnitude: (..., N) m/s^2.
        heading: (..., N) radians, unwrapped here.
        dt: seconds per sample.
        whole_window: tuplan_garage's slip: the accelerations and then the derivatives (of
            accelerations smoothed over 8) over all N samples, so that little but trends remains.
        yaw_accel_order: order of the yaw acceleration's polynomial; 2 where NAVSIM compares plans.
    """
    heading = np.unwrap(np.asarray(heading, np.float64), axis=-1)
    samples = heading.shape[-1]
    acceleration_window, jerk_window = (samples, samples) if whole_window else (8, 15)

    def smooth(values: ArrayLike, window: int, order: int = 2, derivative: int = 0) -> Array:
        values = np.asarray(values, np.float64)
        return values @ _savgol_matrix(values.shape[-1], window, order, derivative, dt)

    return {
        "lon_accel": smooth(lon_accel, acceleration_window),
        "lon_jerk": smooth(smooth(lon_accel, 8), jerk_window, derivative=1),
        "yaw_rate": smooth(heading, 5, derivative=1),
        "yaw_accel": smooth(heading, 5, order=yaw_accel_order, derivative=2),
        "lat_accel": smooth(lat_accel, acceleration_window),
        "jerk": smooth(smooth(magnitude, 8), jerk_window, derivative=1),
    }


@lru_cache(maxsize=64)
def _savgol_matrix(samples: int, window: int, order: int, derivative: int, dt: float) -> Array:
    """(N, N): what each sample adds to each smoothed one; the filter is linear, ends included."""
    from scipy.signal import savgol_filter  # half a second, which most commands need not wait

    unit = np.eye(samples)
    return np.asarray(savgol_filter(unit, window, order, deriv=derivative, delta=dt), np.float64)


def check(
    signals: Mapping[str, Array], limits: Mapping[str, tuple[float, float]], *, strict: bool
) -> BoolArray:
    """Which checks hold throughout: (..., number of limits), in the order of `limits`.

    Args:
        signals: (..., any length) signals by name.
        strict: whether a value on the limit fails, as in nuPlan.
    """
    passed: list[BoolArray] = []
    for name, (low, high) in limits.items():
        value = signals[name]
        inside = (low < value) & (value < high) if strict else (low <= value) & (value <= high)
        passed.append(np.asarray(np.all(inside, axis=-1)))
    return np.stack(passed, axis=-1)


def plan_signals(predictions: ArrayLike, dt: float = 0.1) -> dict[str, Array]:
    """Finite differences of plans (..., 40, 3), the origin put in front (HUGSIM's reading).

    Speed is the displacement over dt, acceleration and jerk its differences; yaw rate and
    acceleration the differences of the heading; lateral acceleration speed times yaw rate. The
    headings of a plan that ends within 1 m of its start count as 0.

    Returns:
        signals by name of the check: (..., 40) and shorter, SI units.
    """
    plan = np.asarray(predictions, np.float64)
    plan = np.concatenate([np.zeros_like(plan[..., :1, :]), plan], axis=-2)
    standing = np.hypot(plan[..., -1, 0], plan[..., -1, 1]) < _STANDING
    heading = np.where(standing[..., None], 0.0, plan[..., 2])
    speed = np.linalg.norm(np.diff(plan[..., :2], axis=-2), axis=-1) / dt
    acceleration = np.diff(speed, axis=-1) / dt
    yaw_rate = se2.wrap_angle(np.diff(heading, axis=-1)) / dt
    return {
        "lon_accel": acceleration,
        "lon_jerk": np.diff(acceleration, axis=-1) / dt,
        "yaw_rate": yaw_rate,
        "yaw_accel": np.diff(yaw_rate, axis=-1) / dt,
        "lat_accel": speed * yaw_rate,
    }


def comfortable_plans(predictions: ArrayLike, dt: float = 0.1) -> BoolArray:
    """Which plans (..., 40, 3) pass all five checks of `PLAN_LIMITS`: (...) bool.

    COM is the share of such plans. It depends on a plan alone, not on the ego's speed.
    """
    passed = check(plan_signals(predictions, dt), PLAN_LIMITS, strict=False)
    return np.asarray(passed.all(axis=-1))
