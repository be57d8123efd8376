"""Poses of AlpaSim's messages as matrices. Numbers on the wire are float32, quaternions wxyz."""

from __future__ import annotations

from typing import Any

import numpy as np

from recast.arrays import Array
from recast.geometry import se3
from recast.logs.checks import WORLD_REACH
from recast_bridges.alpasim.messages import message

_UNIT = 1e-3
"""Farthest that the norm of a quaternion of float32 may be from 1."""


def pose_message(pose: Array) -> Any:
    """The message Pose of `target_from_source` (4, 4)."""
    x, y, z = pose[:3, 3].tolist()
    w, i, j, k = se3.matrix_to_quat(pose[:3, :3]).tolist()
    return message(
        "Pose", vec=message("Vec3", x=x, y=y, z=z), quat=message("Quat", w=w, x=i, y=j, z=k)
    )


def read_pose(pose: Any, where: str) -> Array:
    """`target_from_source` (4, 4) of a message Pose.

    Raises:
        ValueError: it lacks a part, is not finite, is out of this world, or its quaternion is not
            of length 1.
    """
    for part in ("vec", "quat"):
        if not pose.HasField(part):
            raise ValueError(f"{where}.{part}: is missing")
    vec = np.array([pose.vec.x, pose.vec.y, pose.vec.z])
    quat = np.array([pose.quat.w, pose.quat.x, pose.quat.y, pose.quat.z])
    if not np.all(np.abs(vec) <= WORLD_REACH):  # also NaN
        raise ValueError(f"{where}.vec: is not finite, or is beyond {WORLD_REACH:g} m")
    if not abs(np.linalg.norm(quat) - 1.0) <= _UNIT:
        raise ValueError(f"{where}.quat: does not have length 1")
    return se3.from_rotation_translation(se3.quat_to_matrix(quat), vec)


def pose_pair(pose: Array) -> Any:
    """The message PosePair of a pose (4, 4) that does not change during the frame."""
    one = pose_message(pose)
    return message("PosePair", start_pose=one, end_pose=one)


def read_middle(pair: Any, where: str) -> Array:
    """The pose (4, 4) halfway between the two of a message PosePair; equal ones stay as they are.

    Raises:
        ValueError: one is missing, or see `read_pose`.
    """
    for part in ("start_pose", "end_pose"):
        if not pair.HasField(part):
            raise ValueError(f"{where}.{part}: is missing")
    start = read_pose(pair.start_pose, f"{where}.start_pose")
    end = read_pose(pair.end_pose, f"{where}.end_pose")
    if np.array_equal(start, end):
        return start
    return se3.interpolate([0, 2], np.stack([start, end]), 1)


def as_sent(pose: Array) -> Array:
    """What the other side reads of a pose (4, 4): rounded to float32."""
    return read_pose(pose_message(pose), "pose")
