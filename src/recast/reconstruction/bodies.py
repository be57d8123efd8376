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
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
import torch
from numpy.typing import NDArray
from scipy.spatial.transform import Rotation

from recast.arrays import Array
from recast.core.errors import InputError
from recast.core.table_files import npz_names, read_npz
from recast.geometry import se3
from recast.logs import Track, Trajectory
from recast.logs.checks import WORLD_REACH, check_times
from recast.reconstruction.config import SceneConfig
from recast.scene.deformation import MOST_JOINTS, MOST_POSES, Skinning, check_tree, check_weights
from recast.splats import morton_order

Members = Mapping[str, NDArray[Any]]
MOST_VERTICES, MOST_SHAPES = 200_000, 1000
MOST_BYTES = 2_000_000_000
_MODEL_MEND = "save the arrays with numpy.savez; see docs/scenes.md#bodies-on-a-skeleton"
_PARTS = ("timestamps_us", "betas", "global_orient", "body_pose", "transl")


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
