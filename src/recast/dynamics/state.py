"""Vehicles: the state of the ego, and the intelligent driver model (Treiber et al. 2000).

The state is that of the rear axle. Positions and heading are in the world frame; velocity and
acceleration are along the vehicle's own x (forward) and y (left). Units: metres, radians, seconds.
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import Any, Self

import numpy as np
from numpy.typing import ArrayLike

from recast.arrays import Array
from recast.geometry import se2, se3

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
"""The heading is counter-clockwise from the world's x axis, the steering angle positive to the
left; the angular velocity is the yaw rate."""
SIZE = len(COLUMNS)

_STANDS = 1e-6
"""Metres a step up to which a vehicle stands: what rounding leaves of a position."""
_CRAWL = 0.5
"""Speed in m/s below which steering cannot be told from the yaw rate."""


@dataclass(frozen=True)
class VehicleParameters:
    """Outline and wheelbase of a vehicle, measured from its rear axle, in metres.

    The defaults are nuPlan's Chrysler Pacifica, the vehicle the published planners drive.

    Attributes:
        width: width of the body.
        front_length: distance from the rear axle to the front bumper.
        rear_length: distance from the rear axle to the rear bumper.
        wheelbase: distance from the rear axle to the front axle.
    """

    width: float = 2.297
    front_length: float = 4.049
    rear_length: float = 1.127
    wheelbase: float = 3.089

    def __post_init__(self) -> None:
        for name in ("width", "front_length", "rear_length", "wheelbase"):
            if not 0 < getattr(self, name) < math.inf:
                raise ValueError(f"VehicleParameters.{name}: must be positive metres")

    @property
    def length(self) -> float:
        """Bumper to bumper, metres."""
        return self.front_length + self.rear_length

    @property
    def centre_offset(self) -> float:
        """Distance from the rear axle forward to the centre of the box, metres."""
        return (self.front_length - self.rear_length) / 2


PACIFICA = VehicleParameters()


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


def moved_left(states: Array, metres: float) -> Array:
    """States (..., 11) at places `metres` further to the left of their headings."""
    moved = states.copy()
    moved[..., X] -= metres * np.sin(states[..., HEADING])
    moved[..., Y] += metres * np.cos(states[..., HEADING])
    return moved


def ground_velocities(states: ArrayLike) -> Array:
    """Velocities (T, 2) in the world, m/s, of states (T, >=4): x, y, heading, speed >= 0.

    The direction is that of the difference of the positions before and after, at the ends of the
    one neighbour: a vehicle may reverse, slide, or have a wrong heading. Where it does not move it
    is the heading.
    """
    states = np.asarray(states, np.float64)
    heading = states[:, 2]
    direction = np.stack([np.cos(heading), np.sin(heading)], axis=-1)
    if len(states) > 1:
        moved = np.gradient(states[:, :2], axis=0)
        length = np.linalg.norm(moved, axis=1, keepdims=True)
        direction = np.where(length > _STANDS, moved / np.maximum(length, _STANDS), direction)
    return direction * states[:, 3:4]


def initial_state(
    timestamps_us: ArrayLike,
    world_from_rig: ArrayLike,
    timestamp_us: int,
    vehicle: VehicleParameters = PACIFICA,
    dt: float = 0.1,
) -> Array:
    """The state (11,) of a logged trajectory at one time.

    A line is fitted to the speeds of the (at most) four steps of `dt` around the time, each speed
    being the displacement along the mean heading of its step; its value and slope are speed and
    acceleration. The yaw rate comes from the heading changes in the same way. At the ends of the
    log the steps lie on one side.

    Args:
        timestamps_us: (T,) int64 microseconds, strictly increasing.
        world_from_rig: (T, 4, 4) rig poses.
        timestamp_us: time within the recorded interval, microseconds.

    Raises:
        ValueError: the time lies outside the log, or less than `dt` is recorded around it.
    """
    times = np.asarray(timestamps_us, np.int64)
    step = round(dt * 1e6)
    before = int(np.clip((timestamp_us - times[0]) // step, 0, 2))
    after = int(np.clip((times[-1] - timestamp_us) // step, 0, 2))
    query = timestamp_us + step * np.arange(-before, after + 1)
    matrices = se3.interpolate(times, world_from_rig, query)
    if len(query) < 2:
        raise ValueError(f"initial_state: the log holds less than {dt} s around {timestamp_us} us")
    poses = se2.from_se3(matrices)
    turn, displacement = np.diff(np.unwrap(poses[:, 2])), np.diff(poses[:, :2], axis=0)
    heading = poses[:-1, 2] + turn / 2
    along = displacement[:, 0] * np.cos(heading) + displacement[:, 1] * np.sin(heading)
    times_s = (np.arange(len(turn), dtype=np.float64) + 0.5 - before) * dt
    speed, acceleration = _line(times_s, along / dt)
    yaw_rate, _ = _line(times_s, turn / dt)
    return make_state(poses[before], speed, acceleration, yaw_rate, vehicle)


def _line(times_s: Array, values: Array) -> tuple[float, float]:
    """Value at time 0 and slope of the least-squares line; slope 0 for a single value."""
    offset = times_s - times_s.mean()
    slope = float(offset @ values / (offset @ offset)) if len(values) > 1 else 0.0
    return float(values.mean() - slope * times_s.mean()), slope


class _Column:
    """One column of an `EgoState` as a float."""

    def __init__(self, column: int) -> None:
        self._column = column

    def __get__(self, state: EgoState, owner: type[EgoState]) -> float:
        return float(state[self._column])


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
        if array.shape != (SIZE,):
            raise ValueError(f"EgoState: expected ({SIZE},), got {array.shape}")
        return array.view(cls)

    def __getitem__(self, key: Any) -> Any:
        return np.asarray(self)[key]

    def __array_wrap__(self, array: Any, context: Any = None, return_scalar: bool = False) -> Any:
        plain = np.asarray(array)
        return plain[()] if return_scalar else plain

    x = _Column(X)
    """Metres, world."""
    y = _Column(Y)
    """Metres, world."""
    heading = _Column(HEADING)
    """Radians, world, counter-clockwise from the x axis."""
    vx = _Column(VX)
    """Velocity along the heading, m/s."""
    vy = _Column(VY)
    """Velocity to the left, m/s."""
    ax = _Column(AX)
    """Acceleration along the heading, m/s^2."""
    ay = _Column(AY)
    """Acceleration to the left, m/s^2."""
    steering_angle = _Column(STEERING_ANGLE)
    """Radians, left positive."""
    steering_rate = _Column(STEERING_RATE)
    """Radians per second."""
    angular_velocity = _Column(ANGULAR_VELOCITY)
    """Yaw rate, rad/s."""
    angular_acceleration = _Column(ANGULAR_ACCELERATION)
    """rad/s^2."""

    @property
    def pose(self) -> Array:
        """(3,) x, y, heading of the rear axle, world."""
        return self[POSE]

    @property
    def speed(self) -> float:
        """Length of the velocity, m/s."""
        return float(np.hypot(self[VX], self[VY]))


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
