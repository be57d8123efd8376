"""Metrics of a driven rollout, as docs/metrics.md reads the paper's.

NC and TTC: whether the ego meets a controlled actor, and how soon each plan would. DAC and R_c:
whether it stays on the drivable area, and how much of the route it covers. COM: share of the plans
that are comfortable, in three readings; and nuPlan's comfort of what was driven."""

from __future__ import annotations

import math
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass

import numpy as np
import shapely
from numpy.typing import ArrayLike

from recast.arrays import Array, BoolArray
from recast.dynamics import ground_velocities, plan_to_poses
from recast.dynamics import state as ego
from recast.dynamics.tracker import NUPLAN_LIMITS, PLAN_LIMITS, check, plan_signals, savgol_signals
from recast.geometry import Polyline, boxes, se2
from recast.geometry.boxes import TOUCHING
from recast.metrics.table import Metric, invalid

CAP = 4.0
"""Seconds that are looked ahead, and given to a plan that meets nothing: the length of a plan of
40 waypoints 0.1 s apart."""


_STANDING = 0.05
"""m/s up to which a road user stands, as nuPlan has it."""
_BEHIND = np.radians(150.0)
"""Bearing off the ego's heading beyond which what it meets is behind it, as nuPlan has it."""
_HARD, _HARD_SECONDS = 3.0, 0.5
"""m/s^2 over so many seconds that no driver brakes with unless something makes them."""
_MARGIN, _LOOK_AHEAD = 0.5, 2.0
"""Metres beside the ego's way, and seconds ahead, within which an actor is a cause to brake."""
_REACH = 150.0
"""Metres along the route about the ego within which actors are looked for."""
_REACTION, _STANDSTILL = 1.0, 5.0
"""Seconds and metres beyond the way to brake within which it is one."""
_SLIP = np.pi / 6
"""Radians between motion and heading beyond which the heading says nothing of the motion."""


@dataclass(frozen=True)
class Collision:
    """NC of a rollout.

    Attributes:
        nc: 1 without any overlap, else 0.
        overlap: (S+1,) square metres common to both boxes; with several actors the largest.
        first_step: first state with an overlap, or None.
    """

    nc: Metric
    overlap: Array
    first_step: int | None


def no_collision(
    ego_boxes: ArrayLike,
    ego_size: ArrayLike,
    actor: ArrayLike,
    actor_size: ArrayLike,
    dt: float,
    name: str = "the actor",
) -> Collision:
    """NC: 1 iff the boxes' overlap is at most 1e-9 m^2 in every state. No fault is assigned.

    Args:
        ego_boxes: (S+1, 3) x, y, heading of the ego's box centre.
        actor: (S+1, >=3) x, y, heading of the actor's box centre.
        ego_size, actor_size: (>=2,) length and width in metres.
        dt: seconds between states.
    """
    actor = np.asarray(actor, np.float64)
    overlap = boxes.bev_overlap_area(ego_boxes, ego_size, actor[:, :3], actor_size)
    hits = np.flatnonzero(overlap > TOUCHING)
    if len(hits) == 0:
        return Collision(Metric(1.0), overlap, None)
    first = int(hits[0])
    reason = f"overlaps {name} from step {first} ({first * dt:.1f} s)"
    return Collision(Metric(0.0, reason), overlap, first)


def box_gaps(
    ego_boxes: ArrayLike, ego_size: ArrayLike, actor: ArrayLike, actor_size: ArrayLike
) -> Array:
    """Metres (S+1,) between the outlines of two boxes, state by state; 0 where they overlap.

    Args:
        ego_boxes, ego_size, actor, actor_size: see `no_collision`.
    """
    outlines = [
        shapely.polygons(boxes.bev_corners(np.asarray(poses)[:, :3], *np.asarray(size)[:2]))
        for poses, size in ((ego_boxes, ego_size), (actor, actor_size))
    ]
    found: Array = shapely.distance(*outlines)
    return found


def any_collision(collisions: Sequence[Collision]) -> Collision:
    """NC over several actors: 1 iff the ego meets none of them; the first contact counts.

    Args:
        collisions: those of the same ego with each actor, at least one. Of contacts in one state
            the first in this order gives the reason.
    """
    hit = [one for one in collisions if one.first_step is not None]
    first = min(hit, key=lambda one: one.first_step or 0) if hit else collisions[0]
    overlap: Array = np.max([one.overlap for one in collisions], axis=0)
    return Collision(first.nc, overlap, first.first_step)


def no_collision_at_fault(
    collisions: Sequence[Collision], ego_states: ArrayLike, actors: Sequence[ArrayLike]
) -> Metric:
    """NC at fault: 0 iff the ego, in motion, meets an actor that is not behind it, else 1.

    The first state of each contact decides. Into something standing the ego is at fault wherever
    it hits it. Not at fault: standing oneself, or hit from behind. Contact from the side counts,
    as in AlpaSim; nuPlan asks besides whether the ego was across lanes.

    Args:
        collisions: those with each actor.
        ego_states: (S+1, 11) states of the ego.
        actors: (S+1, >=4) x, y, heading of the box centre, speed, of each actor.
    """
    ego_states, told = np.asarray(ego_states, np.float64), []
    for one, actor in zip(collisions, actors, strict=True):
        if one.first_step is None:
            continue
        now, other = ego_states[one.first_step], np.asarray(actor, np.float64)[one.first_step]
        ahead = np.arctan2(other[1] - now[ego.Y], other[0] - now[ego.X]) - now[ego.HEADING]
        if np.hypot(now[ego.VX], now[ego.VY]) <= _STANDING:
            told.append("not at fault: the ego stands")
        elif other[3] > _STANDING and np.abs(se2.wrap_angle(ahead)) > _BEHIND:
            told.append("not at fault: it is hit from behind")
        else:
            return Metric(0.0, one.nc.reason)
    return Metric(1.0, "; ".join(dict.fromkeys(told)) or None)


@dataclass(frozen=True)
class TimeToCollision:
    """TTC of a rollout.

    Attributes:
        ttc: seconds, the least over all cycles.
        per_cycle: (C,) seconds, a multiple of dt, 4.0 where the plan meets nothing. Empty where
            `ttc` has no value.
    """

    ttc: Metric
    per_cycle: Array


def realised_future(
    actor: ArrayLike, steps: ArrayLike, dt: float = 0.1, instants: int | None = None
) -> Array:
    """Actor poses (C, N, 3) at 0, dt, ... below 4 s after each step, as the rollout went on.

    A scripted actor ignores the ego, so its states are its future whatever the ego plans. Of an
    actor that reacts they are what it did. Past the last state the actor moves on at constant
    velocity. This is HUGSIM's reading.

    Args:
        actor: (S+1, 4) x, y, heading, speed of the box centre.
        steps: (C,) steps at which the plans were made.
        instants: number N of instants, if not those below 4 s.
    """
    actor = np.asarray(actor, np.float64)
    index = np.asarray(steps, np.int64)[:, None] + np.arange(instants or _instants(dt))
    last = len(actor) - 1
    known = np.minimum(index, last)
    return _advance(actor[known], _velocity(actor)[known], (index - known) * dt)


def constant_velocity_future(actor: ArrayLike, steps: ArrayLike, dt: float = 0.1) -> Array:
    """Actor poses (C, N, 3) at 0, dt, ... below 4 s after each step, at that step's velocity.

    Args:
        actor, steps: states of the actor and steps of the plans, as for `realised_future`.
    """
    actor = np.asarray(actor, np.float64)
    now = np.asarray(steps, np.int64)[:, None]
    return _advance(actor[now], _velocity(actor)[now], np.arange(_instants(dt)) * dt)


def time_to_collision(
    ego_poses: ArrayLike,
    predictions: ArrayLike,
    ego_size: ArrayLike,
    ego_centre_offset: float,
    actor_future: ArrayLike,
    actor_size: ArrayLike,
    steps: ArrayLike,
    dt: float = 0.1,
    name: str = "the actor",
) -> TimeToCollision:
    """TTC: first time at which a plan's ego box overlaps the actor's, least over the cycles.

    The ego is taken at its current pose and at waypoints 1 to N - 1: with dt 0.1, at 0, 0.1, ...,
    3.9 s. There is no value where plans do not reach that far.

    Args:
        ego_poses: (C, 3) rear axle at each plan step.
        predictions: (C, 40, 3) waypoints in the ego frame.
        ego_size, actor_size: (>=2,) length and width in metres.
        ego_centre_offset: metres from the rear axle to the ego's box centre.
        actor_future: (C, N, 3) box centre at the same times.
        steps: (C,) steps of the plans, for the reason only.
        dt: seconds between waypoints.
    """
    predictions = np.asarray(predictions, np.float64)
    if len(predictions) == 0:
        return TimeToCollision(invalid("no plan was made"), np.zeros(0))
    instants, waypoints = _instants(dt), predictions.shape[1]
    if instants - 1 > waypoints:
        reason = f"plans reach {waypoints * dt:g} s ahead, {CAP:g} s are needed"
        return TimeToCollision(invalid(reason), np.zeros(0))
    poses = plan_to_poses(ego_poses, predictions[:, : instants - 1])
    centres = se2.compose(poses, [ego_centre_offset, 0.0, 0.0])
    hit = boxes.bev_overlap_area(centres, ego_size, actor_future, actor_size) > TOUCHING
    # in whole microseconds: 0.3 s and not 0.30000000000000004 s
    times = np.argmax(hit, axis=1) * round(dt * 1e6) / 1e6
    per_cycle = np.where(hit.any(axis=1), times, CAP)
    worst = int(np.argmin(per_cycle))
    value = float(per_cycle[worst])
    if value == CAP:
        return TimeToCollision(Metric(CAP), per_cycle)
    step = int(np.asarray(steps)[worst])
    reason = f"the plan made at step {step} ({step * dt:.1f} s) meets {name} after {value:.1f} s"
    return TimeToCollision(Metric(value, reason), per_cycle)


def least_time(times: Sequence[TimeToCollision]) -> TimeToCollision:
    """TTC over several actors: the least one.

    Args:
        times: times of the same plans with each actor, at least one. Of equal ones the first in
            this order gives the reason.
    """
    if any(one.ttc.value is None for one in times):
        return next(one for one in times if one.ttc.value is None)
    worst = min(times, key=lambda one: one.ttc.value or 0.0)
    per_cycle: Array = np.min([one.per_cycle for one in times], axis=0)
    return TimeToCollision(worst.ttc, per_cycle)


def _instants(dt: float) -> int:
    """How many of 0, dt, 2 dt, ... lie before 4 s."""
    return math.ceil(CAP / dt - 1e-9)


def _velocity(actor: Array) -> Array:
    """(S+1, 2): along the heading, forwards or backwards, as long as the actor moves within 30
    degrees of it, which is how the reference script reads a lane change; else as it moves."""
    moved = ground_velocities(actor)
    forward = np.stack([np.cos(actor[:, 2]), np.sin(actor[:, 2])], axis=-1)
    along = np.sum(moved * forward, axis=-1)
    rolls = np.abs(along) >= np.cos(_SLIP) * actor[:, 3]
    rolling = (np.sign(along) * actor[:, 3])[:, None] * forward
    return np.where(rolls[:, None], rolling, moved)


def _advance(actor: Array, velocity: Array, time: ArrayLike) -> Array:
    time = np.asarray(time, np.float64)
    position = actor[..., :2] + velocity * time[..., None]
    heading = np.broadcast_to(actor[..., 2:3], (*position.shape[:-1], 1))
    return np.concatenate([position, heading], axis=-1)


TOLERANCE = 0.3
"""Metres that a corner may leave the drivable area."""
_CORNERS = ("front left", "rear left", "rear right", "front right")
_SHORTEST_ROUTE = 1.0
"""Metres of remaining route below which a share of it says nothing."""


@dataclass(frozen=True)
class DrivableArea:
    """DAC of a rollout.

    Attributes:
        dac: 1 while every corner stays within 0.3 m of the drivable area, else 0.
        distance: (S+1, 4) metres from each corner to the area, 0 inside; corners front left, rear
            left, rear right, front right. None without a map.
        first_step: first state with a corner too far out, or None.
    """

    dac: Metric
    distance: Array | None
    first_step: int | None


def drivable_area_compliance(
    ego_boxes: ArrayLike,
    ego_size: ArrayLike,
    region: shapely.Geometry | None,
    dt: float,
    tolerance: float = TOLERANCE,
) -> DrivableArea:
    """DAC: 1 iff all four corners lie within `tolerance` metres of the region in every state.

    Args:
        ego_boxes: (S+1, 3) x, y, heading of the ego's box centre.
        ego_size: (2,) length and width in metres.
        region: region from `drivable_region`; None makes the metric invalid.
        dt: seconds between states.
    """
    if region is None:
        return DrivableArea(invalid("no drivable area in the map"), None, None)
    length, width = np.asarray(ego_size, np.float64)[:2]
    corners = boxes.bev_corners(ego_boxes, length, width)
    shapely.prepare(region)
    distance = np.asarray(shapely.distance(region, shapely.points(corners)), np.float64)
    outside = np.flatnonzero(np.any(distance > tolerance, axis=1))
    if len(outside) == 0:
        return DrivableArea(Metric(1.0), distance, None)
    first = int(outside[0])
    corner = int(np.argmax(distance[first]))
    reason = (
        f"{_CORNERS[corner]} corner {distance[first, corner]:.2f} m outside "
        f"at step {first} ({first * dt:.1f} s); {distance.max():.2f} m at the worst"
    )
    return DrivableArea(Metric(0.0, reason), distance, first)


def no_phantom_braking(
    ego_states: ArrayLike,
    ego_size: ArrayLike,
    centre_offset: float,
    actors: Sequence[tuple[ArrayLike, ArrayLike]],
    route: ArrayLike,
    dt: float,
) -> Metric:
    """1 unless the ego brakes with more than 3 m/s^2 over half a second and no actor is a cause.

    A cause lies ahead on the route within the way that the ego needs to stop with 3 m/s^2, a second
    and 5 m more; an oncoming actor, within what it drives meanwhile besides. Its box is within
    0.5 m of the ego's way now, or will be within 2 s at its velocity.

    Args:
        ego_states: (S+1, 11) states of the ego.
        ego_size: (>=2,) length and width, metres; `centre_offset` from the rear axle to the middle.
        actors: (S+1, >=4) x, y, heading, speed, and size (>=2,), of each actor.
        route: (R, 2) the logged ego path.
        dt: seconds between states.
    """
    states = np.asarray(ego_states, np.float64)
    speed, span = np.hypot(states[:, ego.VX], states[:, ego.VY]), round(_HARD_SECONDS / dt)
    if len(states) <= span:
        return invalid(f"shorter than {_HARD_SECONDS:g} s")
    try:
        line = Polyline.from_points(route)
    except ValueError:
        return invalid("no route")
    braking = (speed[:-span] - speed[span:]) / (span * dt)
    length, width = np.asarray(ego_size, np.float64)[:2]
    along = line.follow(states[:, :2])
    cause = np.zeros(len(states), np.bool_)
    for actor, size in actors:
        path, half = np.asarray(actor, np.float64), np.asarray(size, np.float64)[:2] / 2
        course = path[:, 2] - line.heading(along)
        ways = path[:, 3] * np.stack([np.cos(path[:, 2]), np.sin(path[:, 2])])
        moved = np.linspace(0.0, _LOOK_AHEAD, 5)[:, None, None] * ways.T
        s, lateral = line.to_frenet(path[:, :2] + moved, along, _REACH)
        across = half[0] * np.abs(np.sin(course)) + half[1] * np.abs(np.cos(course))
        near = np.abs(lateral).min(axis=0) - across - width / 2 < _MARGIN
        deep = half[0] * np.abs(np.cos(course)) + half[1] * np.abs(np.sin(course))
        gap = s[0] - along - centre_offset - length / 2 - deep
        needed = speed**2 / (2 * _HARD) + _REACTION * speed + _STANDSTILL
        needed += np.clip(-path[:, 3] * np.cos(course), 0.0, None) * (speed / _HARD + _REACTION)
        cause |= near & (gap > -length - 2 * deep) & (gap < needed)
    lately = np.array([cause[max(k - span, 0) : k + span + 1].any() for k in range(len(braking))])
    phantom = np.where(lately, 0.0, braking)
    if phantom.max() <= _HARD:
        return Metric(1.0)
    first = int(np.argmax(phantom > _HARD))
    told = f"brakes with up to {phantom.max():.1f} m/s2 from step {first} ({first * dt:.1f} s)"
    return Metric(0.0, f"{told}, and nothing is ahead")


@dataclass(frozen=True)
class RouteCompletion:
    """R_c of a rollout, as shares between 0 and 1.

    Attributes:
        r_c: path length driven over the remaining route length.
        r_c_projection: advance of the projection onto the route over the same length.
        route_length: metres from the start pose's projection to the end of the log.
    """

    r_c: Metric
    r_c_projection: Metric
    route_length: float


def route_completion(
    ego_poses: ArrayLike, route: ArrayLike, collision_step: int | None = None
) -> RouteCompletion:
    """R_c = min(1, D / L), D driven up to the first collision, L the route that was left at start.

    Args:
        ego_poses: (S+1, >=2) rear axle.
        route: (R, 2) the logged ego path to the end of the log, rear axle.
        collision_step: step at which counting stops, or None to count all.
    """
    end = None if collision_step is None else collision_step + 1
    path = np.asarray(ego_poses, np.float64)[:end, :2]
    try:
        line = Polyline.from_points(route)
    except ValueError:
        return _no_route(0.0)
    along = line.follow(path)
    remaining = line.length - float(along[0])
    if remaining < _SHORTEST_ROUTE:
        return _no_route(remaining)
    driven = float(np.sum(np.linalg.norm(np.diff(path, axis=0), axis=1)))
    advanced = max(float(along[-1] - along[0]), 0.0)
    return RouteCompletion(
        _share(driven, remaining, collision_step),
        _share(advanced, remaining, collision_step),
        remaining,
    )


def _share(covered: float, remaining: float, collision_step: int | None) -> Metric:
    share = min(1.0, covered / remaining)
    reason = None
    if share < 1.0:
        until = "" if collision_step is None else f" until the collision at step {collision_step}"
        reason = f"{covered:.1f} m of {remaining:.1f} m{until}"
    return Metric(share, reason)


def _no_route(length: float) -> RouteCompletion:
    metric = invalid(f"only {length:.2f} m of the logged route are left")
    return RouteCompletion(metric, metric, length)


LIMITS_4_13: Mapping[str, tuple[float, float]] = {
    name: limits for name, limits in NUPLAN_LIMITS.items() if name != "jerk"
}
"""HUGSIM's five checks with nuPlan's limit on the longitudinal jerk."""
_NUPLAN_DT = 0.1
_WINDOW = 15
"""nuPlan's smoothing counts in samples 0.1 s apart, and its longest window has 15 of them."""
_UNITS = {
    "lon_accel": "m/s^2",
    "lon_jerk": "m/s^3",
    "yaw_rate": "rad/s",
    "yaw_accel": "rad/s^2",
    "lat_accel": "m/s^2",
    "jerk": "m/s^3",
}


@dataclass(frozen=True)
class Comfort:
    """One reading of COM for a rollout.

    Attributes:
        com: share of plans that pass every check.
        checks: names of the checks.
        passed: (C, number of checks) bool; one row for what was driven; none without a value.
    """

    com: Metric
    checks: tuple[str, ...]
    passed: BoolArray

    def failed_checks(self) -> list[list[str]]:
        """Names of the failed checks of each plan."""
        return [
            [name for name, ok in zip(self.checks, row, strict=True) if not ok]
            for row in self.passed
        ]


def plan_savgol_signals(predictions: ArrayLike, dt: float = 0.1) -> dict[str, Array]:
    """nuPlan's smoothing applied to the finite differences of plans (..., 40, 3).

    Accelerations are taken at the 39 inner poses: the lateral one is the mean of its two steps.
    """
    raw = plan_signals(predictions, dt)
    lon, lateral = raw["lon_accel"], raw["lat_accel"]
    lat = (lateral[..., 1:] + lateral[..., :-1]) / 2
    heading = np.cumsum(raw["yaw_rate"], axis=-1) * dt
    heading = np.concatenate([np.zeros_like(heading[..., :1]), heading], axis=-1)
    return savgol_signals(lon, lat, np.hypot(lon, lat), heading, dt)


def com_hugsim(predictions: ArrayLike, dt: float = 0.1) -> Comfort:
    """COM, the headline: five checks on raw finite differences, jerk limit 8.37 m/s^3."""
    return _comfort(predictions, plan_signals, PLAN_LIMITS, dt, strict=False)


def com_4_13(predictions: ArrayLike, dt: float = 0.1) -> Comfort:
    """COM with nuPlan's jerk limit, 4.13 m/s^3, else as `com_hugsim`."""
    return _comfort(predictions, plan_signals, LIMITS_4_13, dt, strict=False)


def com_nuplan_savgol(predictions: ArrayLike, dt: float = 0.1) -> Comfort:
    """COM with nuPlan's six checks and smoothing; no value for other steps than nuPlan's 0.1 s."""
    if abs(dt - _NUPLAN_DT) > 1e-9:
        return _none(_other_steps(dt))
    return _comfort(predictions, plan_savgol_signals, NUPLAN_LIMITS, dt, strict=True)


def driven_signals(states: ArrayLike, dt: float = 0.1) -> dict[str, Array]:
    """nuPlan's smoothed comfort signals (T,) of driven states (T, 11), T >= 15.

    Longitudinal acceleration, yaw rate and heading are those of the rear axle. nuPlan's simulated
    ego has no lateral acceleration, which would make that check idle: here it is v times the yaw
    rate, what a rear axle that does not slip has.
    """
    states = np.asarray(states, np.float64)
    lon = states[..., ego.AX]
    lat = states[..., ego.VX] * states[..., ego.ANGULAR_VELOCITY]
    return savgol_signals(lon, lat, np.hypot(lon, lat), states[..., ego.HEADING], dt)


def com_driven(states: ArrayLike, dt: float = 0.1) -> Comfort:
    """nuPlan's comfort of the motion that was driven: 1 iff its six checks hold throughout, else 0.

    Finer steps are thinned to nuPlan's 0.1 s; there is no value where that cannot be, or for less
    than 15 states.

    Args:
        states: (S+1, 11) states of the ego.
        dt: seconds between states.
    """
    every = max(1, round(_NUPLAN_DT / dt))
    if abs(every * dt - _NUPLAN_DT) > 1e-9:
        return _none(_other_steps(dt))
    states = np.asarray(states, np.float64)[::every]
    if len(states) < _WINDOW:
        seconds = _NUPLAN_DT * (_WINDOW - 1)
        return _none(f"nuPlan's smoothing needs a drive of {seconds:.1f} s or more")
    signals = driven_signals(states, _NUPLAN_DT)
    passed = check(signals, NUPLAN_LIMITS, strict=True)
    failed = [name for name, ok in zip(NUPLAN_LIMITS, passed, strict=True) if not ok]
    reason = "; ".join(_worst(name, signals[name]) for name in failed) or None
    return Comfort(Metric(float(not failed), reason), tuple(NUPLAN_LIMITS), passed[None])


def _worst(name: str, values: Array) -> str:
    """Where a signal leaves its limits furthest, in words."""
    low, high = NUPLAN_LIMITS[name]
    step = int(np.argmax(np.maximum(low - values, values - high)))
    at = step * _NUPLAN_DT
    return f"{name} is {values[step]:.2f} {_UNITS[name]} at {at:.1f} s ({low:g} to {high:g})"


def _other_steps(dt: float) -> str:
    return f"nuPlan's smoothing needs steps of {_NUPLAN_DT} s, but the drive has steps of {dt:g} s"


def _none(reason: str, names: tuple[str, ...] = tuple(NUPLAN_LIMITS)) -> Comfort:
    return Comfort(invalid(reason), names, np.zeros((0, len(names)), np.bool_))


def _comfort(
    predictions: ArrayLike,
    signals: Callable[[ArrayLike, float], dict[str, Array]],
    limits: Mapping[str, tuple[float, float]],
    dt: float,
    *,
    strict: bool,
) -> Comfort:
    names = tuple(limits)
    predictions = np.asarray(predictions, np.float64)
    if len(predictions) == 0:
        return _none("no plan was made", names)
    passed = check(signals(predictions, dt), limits, strict=strict)
    good = np.asarray(passed.all(axis=-1))
    reason = None
    if not good.all():
        counts = {n: int(c) for n, c in zip(names, (~passed).sum(axis=0), strict=True) if c}
        listed = ", ".join(f"{name} in {count}" for name, count in counts.items())
        reason = f"{int((~good).sum())} of {len(good)} plans fail: {listed}"
    return Comfort(Metric(float(good.mean()), reason), names, passed)
