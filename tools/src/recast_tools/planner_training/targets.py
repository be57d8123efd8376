"""What the network is to read from its samples: sub-scores, and what each column shows."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from numpy.typing import NDArray

from recast.arrays import Array
from recast.dynamics import state as ego
from recast.geometry import se2
from recast.geometry.boxes import bev_corners
from recast.planning.gtrs.expert import TargetObstacle
from recast.planning.gtrs.perception import LOOKS_FROM


def unpacked(scores: NDArray[np.uint8]) -> NDArray[np.float32]:
    """Stored scores as values in [0, 1]."""
    return np.asarray(scores / np.float32(255), np.float32)


COLUMN_VALUES = ("present", "distance", "cos", "sin", "vx", "vy")
"""What is seen in one direction, ego frame: whether a road user is within `_SEEN_TO`, the natural
log of its distance in metres, how it is turned, and its velocity against the ego, m/s."""
_SEEN_TO, _NEAREST = 70.0, 1.0
"""Metres."""


def column_values(
    state: Array, obstacles: Sequence[TargetObstacle], directions: Array
) -> NDArray[np.float32]:
    """The nearest road user in each of W columns, (W, 6), see `COLUMN_VALUES`; 0 without one.

    A column is looked at in R directions: 20 m away it is 1.5 m wide, and one look in its middle
    would miss half of the people.

    Args:
        state: (11,) state of the ego, world.
        obstacles: road users with their poses now and 0.1 s later, world.
        directions: (W, R) angles against straight on, radians, to the left positive; those of a
            column side by side, one or more.
    """
    columns, directions = len(directions), directions.ravel()
    found = np.zeros((len(directions), len(COLUMN_VALUES)), np.float32)
    nearest = np.full(len(directions), _SEEN_TO)
    way = np.stack([np.cos(directions), np.sin(directions)], axis=-1)[:, None]
    for one in obstacles:
        pose = se2.relative(state[ego.POSE], one.poses[0])
        corners = bev_corners(pose, *one.size[:2]) - [LOOKS_FROM, 0.0]
        side = np.roll(corners, -1, axis=0) - corners  # (4, 2)
        across = way[..., 0] * side[:, 1] - way[..., 1] * side[:, 0]  # (W, 4)
        across = np.where(np.abs(across) < 1e-9, np.nan, across)
        away = (corners[:, 0] * side[:, 1] - corners[:, 1] * side[:, 0]) / across
        share = (corners[:, 0] * way[..., 1] - corners[:, 1] * way[..., 0]) / across
        met = (away > 0.0) & (share >= 0.0) & (share <= 1.0)
        distance = np.where(met, away, np.inf).min(axis=1)
        closer = distance < nearest
        nearest[closer] = distance[closer]
        moved = se2.relative(one.poses[0], one.poses[1])[:2] / 0.1
        velocity = se2.relative([0.0, 0.0, -pose[2]], [*moved, 0.0])[:2] - [state[ego.VX], 0.0]
        found[closer, 0] = 1.0
        found[closer, 2:] = np.cos(pose[2]), np.sin(pose[2]), *velocity
    found[:, 1] = found[:, 0] * np.log(np.maximum(nearest, _NEAREST))
    chosen = nearest.reshape(columns, -1).argmin(axis=1)
    return found.reshape(columns, -1, len(COLUMN_VALUES))[np.arange(columns), chosen]
