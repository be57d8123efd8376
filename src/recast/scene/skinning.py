"""Bodies on a skeleton: Gaussians bound to joints by linear blend skinning (OmniRe's SMPL nodes).

SMPL (Loper et al. 2015, section 3): rest vertices of a shape, joints as averages of vertices, and
each vertex moved by the weighted mean of its joints' transforms. Corrections of the rest shape by
the pose (`posedirs`) are left out.
"""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np
import torch
from numpy.typing import NDArray
from scipy.spatial.transform import Rotation
from torch import Tensor
from torch.nn import functional

from recast.arrays import Array
from recast.geometry import se3
from recast.logs import Trajectory
from recast.logs.checks import check_times
from recast.splats import Gaussians
from recast.splats.gaussians import LARGEST, quat_multiply

MOST_JOINTS, MOST_POSES = 256, 1_000_000
UNIT_TOLERANCE = 1e-3
"""How far the weights of a Gaussian may be from adding up to 1, and a quaternion from length 1."""


@dataclass(frozen=True)
class Skinning:
    """How the Gaussians of one body move over its time.

    Gaussians are in the body's rest frame; `at` puts them into the box frame of their actor.

    Attributes:
        weights: (N, J) float32, of the joints in each Gaussian's motion; rows add up to 1.
        joints: (J, 3) float64 rest places, metres.
        parents: (J,) int64, -1 for the first joint and an earlier joint for all others.
        timestamps_us: (T,) int64.
        rotations: (T, J, 4) float64 quaternions wxyz of the joints in their parents' frames; the
            first is `box_from_body`.
        translations: (T, 3) float64 metres in the box frame, added to all.
    """

    weights: Tensor
    joints: Array
    parents: NDArray[np.int64]
    timestamps_us: NDArray[np.int64]
    rotations: Array
    translations: Array

    def validate(self, where: str, count: int) -> None:
        """Raise ValueError naming the member at fault of an actor `where` of `count` Gaussians."""
        joints, times = len(self.parents), len(self.timestamps_us)
        if not 1 <= joints <= MOST_JOINTS or not 1 <= times <= MOST_POSES:
            raise ValueError(f"{where}: {joints} joints and {times} poses")
        shapes = {
            "weights": (count, joints),
            "joints": (joints, 3),
            "parents": (joints,),
            "timestamps_us": (times,),
            "rotations": (times, joints, 4),
            "translations": (times, 3),
        }
        for name, shape in shapes.items():
            value = getattr(self, name)
            if tuple(value.shape) != shape:
                raise ValueError(f"{where}.{name}: expected {shape}, got {tuple(value.shape)}")
        check_times(f"{where}.timestamps_us", self.timestamps_us)
        check_tree(where, self.parents)
        check_weights(where, self.weights.detach().double().numpy())
        for name in ("joints", "translations"):
            if not np.all(np.abs(getattr(self, name)) < LARGEST):  # also NaN
                raise ValueError(f"{where}.{name}: a value is not finite, or out of range")
        norms = np.linalg.norm(self.rotations, axis=2)
        if not np.all(np.abs(norms - 1) < UNIT_TOLERANCE):
            raise ValueError(f"{where}.rotations: a quaternion is not of length 1")

    def at(self, gaussians: Gaussians, trajectory: Trajectory, timestamp_us: int) -> Gaussians:
        """The Gaussians in the box frame at a time; before the first and after the last, as then.

        Differentiable in the Gaussians. Their rotation is the weighted mean of the joints'
        quaternions. View-dependent colour does not turn with the limbs.
        """
        del trajectory
        moved, turns = (
            torch.from_numpy(part).to(gaussians.means) for part in self._joints_at(timestamp_us)
        )
        weights = self.weights.to(gaussians.means)
        blend = (weights @ moved.flatten(1)).view(-1, 3, 4)
        means = (blend[:, :, :3] @ gaussians.means[:, :, None])[..., 0] + blend[:, :, 3]
        # A quaternion and its negative are one rotation: all take the sign nearest to the heaviest.
        heaviest = turns[weights.argmax(dim=1)]
        signs = torch.sign(heaviest @ turns.T + 1e-9)
        turn = functional.normalize((weights * signs) @ turns, dim=1)
        return replace(gaussians, means=means, quats=quat_multiply(turn, gaussians.quats))

    def _joints_at(self, timestamp_us: int) -> tuple[Array, Array]:
        """Rest-to-box transforms (J, 3, 4) of the joints, and their rotations (J, 4)."""
        place = np.interp(timestamp_us, self.timestamps_us, np.arange(len(self.timestamps_us)))
        left = min(int(place), max(len(self.timestamps_us) - 2, 0))
        right, share = min(left + 1, len(self.timestamps_us) - 1), place - left
        rotations = se3.slerp(self.rotations[left], self.rotations[right], share)
        shift = (1 - share) * self.translations[left] + share * self.translations[right]
        poses = joint_poses(se3.quat_to_matrix(rotations), self.joints, self.parents)
        poses[:, :3, 3] += shift
        rest = np.einsum("jab,jb->ja", poses[:, :3, :3], self.joints)
        moved = np.concatenate([poses[:, :3, :3], (poses[:, :3, 3] - rest)[..., None]], axis=2)
        return moved, se3.matrix_to_quat(poses[:, :3, :3])


def joint_poses(rotations: Array, joints: Array, parents: NDArray[np.int64]) -> Array:
    """Poses (J, 4, 4) `body_from_joint` of a skeleton.

    Args:
        rotations: (J, 3, 3) in the parents' frames.
        joints: (J, 3) rest places.
        parents: (J,), see `Skinning`.
    """
    poses = np.tile(np.eye(4), (len(joints), 1, 1))
    for joint, parent in enumerate(parents):
        poses[joint, :3, :3] = rotations[joint]
        poses[joint, :3, 3] = joints[joint] - (0 if parent < 0 else joints[parent])
        if parent >= 0:
            poses[joint] = poses[parent] @ poses[joint]
    return poses


def in_box_frame(
    rotations: Array,
    translations: Array,
    root: Array,
    trajectory: Trajectory,
    times: NDArray[np.int64],
) -> tuple[Array, Array]:
    """Poses of a body in the world, said in the frames of its box.

    Args:
        rotations: (T, J, 3) rotation vectors, the first of each pose `world_from_body`.
        translations: (T, 3) world frame, metres.
        root: (3,) rest place of the first joint.
        trajectory: `world_from_box`; held at its ends.
        times: (T,) microseconds.

    Returns:
        Quaternions (T, J, 4) and translations (T, 3), as `Skinning` has them.
    """
    held = np.clip(times, trajectory.timestamps_us[0], trajectory.timestamps_us[-1])
    box_from_world = se3.inverse(trajectory.at(held))
    turns = Rotation.from_rotvec(rotations.reshape(-1, 3)).as_matrix().reshape(*rotations.shape, 3)
    turns[:, 0] = box_from_world[:, :3, :3] @ turns[:, 0]
    shifts = np.einsum("tab,tb->ta", box_from_world[:, :3, :3], root + translations)
    shifts = shifts + box_from_world[:, :3, 3] - root
    return se3.matrix_to_quat(turns), shifts


def check_tree(where: str, parents: NDArray[np.int64]) -> None:
    """Raise ValueError unless the first joint has no parent and all others an earlier one."""
    numbers = np.arange(len(parents))
    if parents[0] != -1 or np.any(parents[1:] < 0) or np.any(parents[1:] >= numbers[1:]):
        raise ValueError(f"{where}.parents: -1, then for each joint an earlier one, got {parents}")


def check_weights(where: str, weights: Array) -> None:
    """Raise ValueError unless weights (N, J) are not negative and add up to 1."""
    if not (np.all(weights >= -UNIT_TOLERANCE) and np.all(weights <= 1 + UNIT_TOLERANCE)):
        raise ValueError(f"{where}.weights: a value is not within 0 and 1")
    if not np.all(np.abs(weights.sum(axis=1) - 1) < UNIT_TOLERANCE):
        raise ValueError(f"{where}.weights: a row does not add up to 1")
