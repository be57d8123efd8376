"""Where actors and cameras are: poses of tracks at a time, learned corrections of cameras."""

from __future__ import annotations

from collections.abc import Mapping

import numpy as np
import torch
from torch import Tensor

from recast.arrays import Array, Int64Array
from recast.logs import Trajectory

DEFORMABLE = frozenset({"pedestrian"})
"""Categories that are not symmetric at every moment."""
ARTICULATED = frozenset({"pedestrian", "cyclist"})
"""Categories that have limbs: what deformable nodes are for."""
MOVED_M = 2.0
SPREAD_M = 0.5
CLOCK_TOLERANCE_US = 60_000
"""Sensors of one frame fire up to half a period of 10 Hz (and a little) apart."""


def moves(trajectory: Trajectory) -> bool:
    """Whether a track counts as moving in the world.

    First and last position more than 2 m apart, or a spread along an axis above 0.5 m (Street
    Gaussians' rule), the first so that label noise of parked cars does not count.
    """
    positions = trajectory.poses[:, :3, 3]
    travelled = float(np.linalg.norm(positions[-1] - positions[0]))
    return travelled > MOVED_M or bool(np.any(positions.std(axis=0) > SPREAD_M))


def stands(trajectory: Trajectory) -> bool:
    """Whether every pose is the same, as `choose_actors` makes those of parked vehicles."""
    return bool(np.all(trajectory.poses == trajectory.poses[:1]))


def pose_at(trajectory: Trajectory, timestamp_us: int) -> Array | None:
    """World pose (4, 4) at a time, or None where the track is absent.

    Interpolated in the world frame. A camera that fires shortly before the first or after the last
    label still saw the object: there the end pose is held.
    """
    first, last = int(trajectory.timestamps_us[0]), int(trajectory.timestamps_us[-1])
    if not first - CLOCK_TOLERANCE_US <= timestamp_us <= last + CLOCK_TOLERANCE_US:
        return None
    return trajectory.at(min(max(timestamp_us, first), last))


def corrected(
    camera_from_world: Array,
    corrections: Mapping[str, tuple[Int64Array, Array]],
    camera_name: str,
    timestamp_us: int,
) -> Array:
    """A logged pose (4, 4) with the learned correction at its time.

    Interpolated linearly between the neighbouring training views, held before the first and after
    the last; cameras that were not trained on stay as logged.
    """
    if camera_name not in corrections:
        return camera_from_world
    times, twists = corrections[camera_name]
    twist = [np.interp(timestamp_us, times, twists[:, i]) for i in range(6)]
    moved: Array = twist_matrix(torch.tensor(twist, dtype=torch.float64)).numpy()
    return moved @ camera_from_world


def twist_matrix(twist: Tensor) -> Tensor:
    """Rigid matrix (4, 4) of a twist (6,): rotation by Rodrigues' formula, translation as it is.

    The translation is not multiplied by SO(3)'s left Jacobian: the parametrisation is as good a
    chart near zero, and decoupled.
    """
    rotation = twist[3:]
    theta2 = rotation.dot(rotation)
    small = theta2 < 1e-8
    safe = torch.where(small, torch.ones_like(theta2), theta2)
    theta = safe.sqrt()
    a = torch.where(small, 1 - theta2 / 6, theta.sin() / theta)
    b = torch.where(small, 0.5 - theta2 / 24, (1 - theta.cos()) / safe)
    x, y, z = rotation.unbind()
    zero = torch.zeros_like(x)
    skew = torch.stack([zero, -z, y, z, zero, -x, -y, x, zero]).view(3, 3)
    turn = torch.eye(3, dtype=twist.dtype) + a * skew + b * (skew @ skew)
    top = torch.cat([turn, twist[:3, None]], dim=1)
    bottom = torch.tensor([[0.0, 0.0, 0.0, 1.0]], dtype=twist.dtype)
    return torch.cat([top, bottom])
