"""Bodies on a skeleton (OmniRe's SMPL nodes): linear blend skinning, and a user's files of them.

SMPL (Loper et al. 2015, section 3): rest vertices of a shape, joints as averages of vertices, each
vertex moved by the weighted mean of its joints' transforms; without pose correctives (`posedirs`).

The files are NumPy archives without pickled objects (docs/scenes.md); neither is shipped with
recast. The body model: `v_template` (V, 3), `shapedirs` (V, 3, B), `J_regressor` (J, V), `weights`
(V, J), and `parents` (J,) or `kintree_table` (2, J); other members are not read. The poses: for
each track `ID/timestamps_us` (T,), `ID/betas` (at most B), `ID/global_orient` (T, 3),
`ID/body_pose` (T, J - 1, 3) and `ID/transl` (T, 3).
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

import numpy as np
import torch
from numpy.typing import NDArray
from scipy.spatial.transform import Rotation
from torch import Tensor
from torch.nn import functional

from recast.arrays import Array
from recast.core.array_files import npz_names, read_npz
from recast.core.errors import InputError
from recast.geometry import se3
from recast.logs import Track, Trajectory
from recast.logs.checks import WORLD_REACH, check_times
from recast.scene.config import SceneConfig
from recast.splats import Gaussians, morton_order
from recast.splats.gaussians import LARGEST, quat_multiply

MOST_JOINTS, MOST_POSES = 256, 1_000_000
UNIT_TOLERANCE = 1e-3
"""How far the weights of a Gaussian may be from adding up to 1, and a quaternion from length 1."""
Members = Mapping[str, NDArray[Any]]

MOST_VERTICES, MOST_SHAPES = 200_000, 1000
MOST_BYTES = 2_000_000_000
_MODEL_MEND = "save the arrays with numpy.savez; see docs/scenes.md#bodies-on-a-skeleton"
_PARTS = ("timestamps_us", "betas", "global_orient", "body_pose", "transl")


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


@dataclass(frozen=True)
class Body:
    """A body at rest and its motion.

    Attributes:
        vertices: (V, 3) rest places, metres, in Morton order.
        skinning: the motion of Gaussians at these vertices.
    """

    vertices: Array
    skinning: Skinning


def read_bodies(config: SceneConfig, tracks: Mapping[str, Track]) -> dict[str, Body]:
    """Bodies by track id, as the configuration's files have them; none without files.

    Args:
        tracks: the actors of the scene.

    Raises:
        InputError: only one of the two files is named; one is missing, damaged, too large, or has
            values that no body has; or it names a track that is no actor of the scene.
    """
    if not config.smpl_model and not config.smpl_poses:
        return {}
    if not config.smpl_model or not config.smpl_poses:
        lacking = "smpl_poses" if config.smpl_model else "smpl_model"
        raise InputError("configuration", lacking, "is not named", "name both files or none")
    poses_path = Path(config.smpl_poses)
    model, poses = _read_model(Path(config.smpl_model)), _read_archive(poses_path, None)
    found = {}
    for track_id in sorted({name.rpartition("/")[0] for name in poses}):
        if track_id not in tracks:
            mend = "take it out, or name it in force_dynamic"
            raise InputError(
                poses_path, f"track {track_id!r}", "is not an actor of the scene", mend
            )
        try:
            found[track_id] = _body(model, poses, tracks[track_id])
        except ValueError as error:
            raise InputError(poses_path, f"track {track_id}", str(error), "correct it") from None
    return found


def _body(model: Members, poses: Members, track: Track) -> Body:
    parts = {}
    for part in _PARTS:
        name = f"{track.track_id}/{part}"
        if name not in poses:
            raise ValueError(f"{part} is missing")
        parts[part] = poses[name]
    times, betas = parts["timestamps_us"], parts["betas"]
    if times.ndim != 1 or not 1 <= len(times) <= MOST_POSES or times.dtype.kind not in "iu":
        raise ValueError(f"timestamps_us: expected (T,) whole numbers, got {times.shape}")
    stamps = times.astype(np.int64)
    check_times("timestamps_us", stamps)
    joints = len(model["parents"])
    expected = {
        "global_orient": (len(times), 3),
        "body_pose": (len(times), joints - 1, 3),
        "transl": (len(times), 3),
    }
    for part, shape in expected.items():
        if parts[part].shape != shape:
            raise ValueError(f"{part}: expected {shape}, got {parts[part].shape}")
        limit = WORLD_REACH if part == "transl" else 100.0
        if not np.all(np.abs(parts[part]) <= limit):  # also NaN
            raise ValueError(f"{part}: a value is not finite, or beyond {limit:g}")
    shapes = model["shapedirs"]
    if betas.ndim != 1 or len(betas) > shapes.shape[2] or not np.all(np.abs(betas) <= 100):
        raise ValueError(f"betas: at most {shapes.shape[2]} finite numbers, got {betas.shape}")
    vertices = model["v_template"] + shapes[:, :, : len(betas)] @ betas
    places = model["J_regressor"] @ vertices
    rotations = np.concatenate([parts["global_orient"][:, None], parts["body_pose"]], axis=1)
    quats, shifts = in_box_frame(
        rotations.astype(np.float64),
        parts["transl"].astype(np.float64),
        places[0],
        track.trajectory,
        stamps,
    )
    # In the order that first Gaussians have.
    order = morton_order(torch.from_numpy(vertices).float())
    weights = torch.from_numpy(model["weights"]).float()[order]
    parents = model["parents"].astype(np.int64)
    skinning = Skinning(weights, places, parents, stamps, quats, shifts)
    return Body(vertices[order.numpy()], skinning)


def _read_model(path: Path) -> Members:
    wanted = ("v_template", "shapedirs", "J_regressor", "weights", "parents", "kintree_table")
    found = _read_archive(path, wanted)
    if "parents" not in found and "kintree_table" in found:
        found["parents"] = found["kintree_table"].reshape(-1, found["kintree_table"].shape[-1])[0]
    for name in wanted[:5]:
        if name not in found:
            raise InputError(path, name, "is missing", _MODEL_MEND)
    vertices, joints = found["v_template"].shape[0], found["parents"].size
    shapes = found["shapedirs"].shape[-1]
    counts = ((vertices, MOST_VERTICES), (joints, MOST_JOINTS), (shapes, MOST_SHAPES))
    if not all(1 <= count <= most for count, most in counts):
        problem = f"have {vertices} vertices, {joints} joints and {shapes} shapes"
        raise InputError(path, "members", problem, _MODEL_MEND)
    expected = {
        "v_template": (vertices, 3),
        "shapedirs": (vertices, 3, shapes),
        "J_regressor": (joints, vertices),
        "weights": (vertices, joints),
        "parents": (joints,),
    }
    for name, shape in expected.items():
        if found[name].shape != shape:
            problem = f"expected {shape}, got {found[name].shape}"
            raise InputError(path, name, problem, _MODEL_MEND)
        if not np.all(np.isfinite(found[name])):
            raise InputError(path, name, "a value is not finite", _MODEL_MEND)
    # SMPL's own tables mark the first joint's lack of a parent by the largest unsigned number.
    parents = found["parents"].astype(np.float64)
    tree = np.where(parents > MOST_JOINTS, -1, parents).astype(np.int64)
    try:
        check_tree("skeleton", tree)
        check_weights("skin", found["weights"])
    except ValueError as error:
        raise InputError(path, "body model", str(error), _MODEL_MEND) from None
    return {name: found[name].astype(np.float64) for name in expected} | {"parents": tree}


def _read_archive(path: Path, wanted: tuple[str, ...] | None) -> dict[str, NDArray[Any]]:
    """Numeric members of an .npz file; sizes are checked before memory is taken."""
    names = [n for n in npz_names(path, _MODEL_MEND) if wanted is None or n in wanted]
    arrays = read_npz(path, _MODEL_MEND, names, MOST_BYTES)
    for name, array in arrays.items():
        if array.dtype.kind not in "fiu" or array.size == 0:
            problem = f"holds {array.shape} of {array.dtype}, not numbers"
            raise InputError(path, name, problem, _MODEL_MEND)
    return arrays
