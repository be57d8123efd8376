"""Ego trajectories made in memory, and planner inputs on them."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from recast.dynamics import make_state
from recast.geometry import se2
from recast.logs.types import Trajectory
from recast.planning import ActorState, PlannerInput, PlanningContext, ReferenceRoute

START_US = 2_000_000


def arc(
    speed: float = 10.0,
    seconds: float = 20.0,
    curvature: float = 0.0,
    world_from_start: tuple[float, float, float] = (0.0, 0.0, 0.0),
) -> Trajectory:
    """A drive at constant speed along a circle of the given curvature (1/m)."""
    times = np.arange(round(seconds * 10) + 1)
    s = speed * 0.1 * times
    heading = curvature * s
    half = heading / 2  # of the chord; 1 - cos would lose the digits of slight curves
    xy = (
        s[:, None]
        * np.sinc(half / np.pi)[:, None]
        * np.stack([np.cos(half), np.sin(half)], axis=-1)
    )
    poses = se2.compose(world_from_start, np.concatenate([xy, heading[:, None]], axis=1))
    return Trajectory((START_US + 100_000 * times).astype(np.int64), se2.to_se3(poses))


def context(trajectory: Trajectory) -> PlanningContext:
    return PlanningContext(ReferenceRoute.from_trajectory(trajectory), trajectory)


def observe(
    pose: tuple[float, float, float], speed: float, *actors: ActorState, seconds: float = 0.0
) -> PlannerInput:
    state = make_state(np.array(pose), speed)
    return PlannerInput(
        step=round(seconds * 10),
        timestamp_us=START_US + round(seconds * 1e6),
        ego=state,
        ego_history=state[None],
        actors=actors,
        command=context(arc()).route.command(state),
    )


def car(x: float, y: float, heading: float = 0.0, vx: float = 0.0, vy: float = 0.0) -> ActorState:
    pose: NDArray[np.float64] = np.array([x, y, heading])
    return ActorState("1", "car", pose, np.array([vx, vy]), np.array([4.0, 1.8, 1.5]))
