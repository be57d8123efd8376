"""PDM's collision scores for hundreds of trajectories at once, against known futures.

The same verdicts as `recast.planning.pdm.collisions` gives where the ego is always to blame for
contacts from the side (its areas say "multiple lanes" everywhere), without its loops over pairs.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import ArrayLike, NDArray

from recast.dynamics import VehicleParameters
from recast.dynamics import state as ego
from recast.geometry import se2
from recast.planning.pdm.footprint import box_centres
from recast.planning.types import WAYPOINTS

Array = NDArray[np.float64]
BoolArray = NDArray[np.bool_]

FORESEEN = WAYPOINTS + 9
"""Steps that obstacles are known ahead: the time to collision looks 0.9 s further."""

_LOOK_AHEAD = np.array([0, 3, 6, 9])
_STOPPED, _STOPPED_TTC, _BEHIND = 0.05, 0.005, np.deg2rad(150)


@dataclass(frozen=True)
class Obstacle:
    """A road user whose future is known.

    Attributes:
        token: its id.
        poses: (FORESEEN + 1, 3) x, y, heading of its box centre from now on, world.
        size: (>=2,) length and width, metres.
    """

    token: str
    poses: Array
    size: Array


def collisions(
    states: Array, obstacles: Sequence[Obstacle], vehicle: VehicleParameters, dt: float = 0.1
) -> tuple[Array, Array]:
    """NC and TTC (P,), 0 or 1, of simulated states (P, 41, 11).

    Each obstacle counts by its first contact: not the ego's fault where the ego stands or is hit
    from behind (more than 150 degrees off its heading), and ignored from then on. For TTC the box
    is moved on at constant velocity by 0, 0.3, 0.6 and 0.9 s.
    """
    count, steps = states.shape[:2]
    safe, clear = np.ones(count), np.ones(count)
    poses = states[..., ego.POSE]
    speed = np.hypot(states[..., ego.VX], states[..., ego.VY])
    heading = poses[..., 2]
    way = np.stack([np.cos(heading), np.sin(heading)], axis=-1) * (dt * speed)[..., None]
    # (P, T, F, 3): boxes now and moved on.
    boxes = np.repeat(box_centres(poses, vehicle)[:, :, None], len(_LOOK_AHEAD), axis=2)
    boxes[..., :2] += _LOOK_AHEAD[:, None] * way[:, :, None]
    when = np.arange(steps)[:, None] + _LOOK_AHEAD  # (T, F)
    rows = np.arange(count)
    for obstacle in obstacles:
        there = obstacle.poses[when]  # (T, F, 3)
        if not _near(boxes, there, obstacle, vehicle):
            continue
        size = (vehicle.length, vehicle.width)
        touching = overlapping(boxes, size, there, obstacle.size)
        offset = there[..., :2] - poses[:, :, None, :2]
        bearing = np.abs(
            se2.wrap_angle(np.arctan2(offset[..., 1], offset[..., 0]) - heading[..., None])
        )
        now = touching[..., 0]
        first = now.argmax(axis=1)
        # The obstacle's speed now decides, as in PDM.
        standing = np.hypot(*(obstacle.poses[1, :2] - obstacle.poses[0, :2])) / dt <= _STOPPED
        fault = now.any(axis=1) & (speed[rows, first] > _STOPPED)
        safe[fault & (standing | (bearing[rows, first, 0] <= _BEHIND))] = 0.0
        soon = (touching & (speed >= _STOPPED_TTC)[..., None]).reshape(count, -1)
        first = soon.argmax(axis=1)
        clear[soon.any(axis=1) & (bearing.reshape(count, -1)[rows, first] <= _BEHIND)] = 0.0
    return safe, clear


def overlapping(
    poses_a: ArrayLike, size_a: ArrayLike, poses_b: ArrayLike, size_b: ArrayLike
) -> BoolArray:
    """Which rectangles (...) overlap: none of their four side directions parts them.

    Args:
        poses_a, poses_b: (..., 3) of their centres.
        size_a, size_b: (>=2,) length and width.
    """
    a, b = np.asarray(poses_a, np.float64), np.asarray(poses_b, np.float64)
    half_a, half_b = np.asarray(size_a)[:2] / 2, np.asarray(size_b)[:2] / 2
    dx, dy, turn = b[..., 0] - a[..., 0], b[..., 1] - a[..., 1], b[..., 2] - a[..., 2]
    cos, sin = np.abs(np.cos(turn)), np.abs(np.sin(turn))
    found = np.ones(turn.shape, np.bool_)
    for heading, own, other in ((a[..., 2], half_a, half_b), (b[..., 2], half_b, half_a)):
        c, s = np.cos(heading), np.sin(heading)
        found &= np.abs(dx * c + dy * s) <= own[0] + other[0] * cos + other[1] * sin
        found &= np.abs(dy * c - dx * s) <= own[1] + other[0] * sin + other[1] * cos
    return found


def _near(boxes: Array, there: Array, obstacle: Obstacle, vehicle: VehicleParameters) -> bool:
    """Whether any box comes close to an obstacle's at all."""
    reach = (np.hypot(vehicle.length, vehicle.width) + np.hypot(*obstacle.size[:2])) / 2
    low, high = boxes[..., :2].min(axis=(0, 1, 2)), boxes[..., :2].max(axis=(0, 1, 2))
    points = there[..., :2]
    inside = (points >= low - reach) & (points <= high + reach)
    return bool(inside.all(axis=-1).any())
