"""NC and TTC: whether the ego meets a controlled actor, and how soon each plan would."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import ArrayLike

from recast.arrays import Array
from recast.dynamics import ground_velocities, plan_to_poses
from recast.geometry import boxes, se2
from recast.metrics.table import Metric, invalid

TOUCHING = 1e-9
"""Overlap in square metres up to which boxes merely touch."""
CAP = 4.0
"""Seconds that are looked ahead, and given to a plan that meets nothing: the length of a plan of
40 waypoints 0.1 s apart."""


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
        name: name of the actor, for the reason.
    """
    actor = np.asarray(actor, np.float64)
    overlap = boxes.bev_overlap_area(ego_boxes, ego_size, actor[:, :3], actor_size)
    hits = np.flatnonzero(overlap > TOUCHING)
    if len(hits) == 0:
        return Collision(Metric(1.0), overlap, None)
    first = int(hits[0])
    reason = f"overlaps {name} from step {first} ({first * dt:.1f} s)"
    return Collision(Metric(0.0, reason), overlap, first)


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
        name: name of the actor, for the reason.
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
