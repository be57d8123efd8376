"""A made-up body on SMPL's tree of 24 joints that walks as our own body does.

Its skin is that of `surface_of`, put into SMPL's rest pose: x left, y up, z ahead, arms level.
"""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import torch
from scipy.spatial.transform import Rotation

from actors.people.made_up_people import COLOURS
from recast.actors.people.body import BodySurface, PersonShape, part_poses, surface_of
from recast.actors.people.views import gaussians_of
from recast.geometry import se3
from recast.logs import Trajectory
from recast.scene.actor import SceneActor
from recast.scene.deformation import Skinning

PARENTS = np.array([-1, *[0] * 3, *range(1, 10), 9, 9, 12, 13, 14, *range(16, 22)])
BOX_FROM_REST = np.array([[0.0, 0, 1], [1, 0, 0], [0, 1, 0]])
LEFT, RIGHT = (2, 3, 4, 5, 6), (7, 8, 9, 10, 11)  # parts: thigh, shin, foot, upper arm, forearm
JOINTS = {LEFT: (1, 4, 7, 16, 18), RIGHT: (2, 5, 8, 17, 19)}
HANDS = {LEFT[4]: 20, RIGHT[4]: 21}


def _frames(shape: PersonShape) -> np.ndarray:
    """(12, 4, 4) poses of the parts at rest, axes of the box: legs hang, arms are level."""
    rest = np.tile(np.eye(4), (12, 1, 1))
    posed = part_poses(shape, 0.0)
    hips = posed[0, :3, 3]
    for parts, sign in ((LEFT, 1.0), (RIGHT, -1.0)):
        thigh, shin, foot, upper, fore = (posed[k, :3, 3] for k in parts)
        lengths = [np.linalg.norm(b - a) for a, b in ((thigh, shin), (shin, foot), (upper, fore))]
        down, aside = np.array([0.0, 0, -1]), np.array([0.0, sign, 0])
        rest[parts[0], :3, 3] = thigh - hips
        rest[parts[1], :3, 3] = rest[parts[0], :3, 3] + lengths[0] * down
        rest[parts[2], :3, 3] = rest[parts[1], :3, 3] + lengths[1] * down
        level = Rotation.from_euler("x", sign * np.pi / 2).as_matrix()  # what hangs points aside
        rest[parts[3], :3, 3] = upper - hips
        rest[parts[4], :3, 3] = rest[parts[3], :3, 3] + lengths[2] * aside
        rest[parts[3], :3, :3] = rest[parts[4], :3, :3] = level
    rest[1, :3, 3] = posed[1, :3, 3] - hips
    return rest


def skin(shape: PersonShape, spacing: float = 0.03) -> tuple[np.ndarray, np.ndarray, BodySurface]:
    """Weights (N, 24), rest joints (24, 3), and the surface at rest, N patches."""
    surface, frames, posed = surface_of(shape, spacing), _frames(shape), part_poses(shape, 0.0)
    part = surface.weights.argmax(axis=1)
    back = (frames @ se3.inverse(posed))[part]
    local = np.einsum("nab,nb->na", back[:, :3, :3], surface.points) + back[:, :3, 3]
    normals = np.einsum("nab,nb->na", back[:, :3, :3], surface.normals)
    size = shape.height
    joints = np.zeros((24, 3))
    for parts, numbers in JOINTS.items():
        joints[list(numbers)] = frames[list(parts), :3, 3]
        sign = 1.0 if parts is LEFT else -1.0
        toe, wrist, hand = (10, 20, 22) if parts is LEFT else (11, 21, 23)
        joints[toe] = joints[numbers[2]] + [0.08 * size, 0, -0.03 * size]
        joints[wrist] = joints[numbers[4]] + [0, sign * 0.146 * size, 0]
        joints[hand] = joints[wrist] + [0, sign * 0.05 * size, 0]
        joints[13 if parts is LEFT else 14] = [0, sign * 0.04 * size, 0.26 * size]
    joints[[3, 6, 9, 12], 2] = size * np.array([0.06, 0.13, 0.19, 0.3])
    joints[15] = frames[1, :3, 3] - [0, 0, 0.04 * size]
    weights = np.zeros((len(part), 24))
    moving = {
        k: j for parts, numbers in JOINTS.items() for k, j in zip(parts, numbers, strict=True)
    }
    rows = np.arange(len(part))
    for k in range(12):
        for n in rows[surface.weights[:, k] > 0]:
            weights[n, _joint(k, moving, local[n], surface.region[n], size)] += surface.weights[
                n, k
            ]
    at_rest = replace(surface, points=local @ BOX_FROM_REST, normals=normals @ BOX_FROM_REST)
    return weights, joints @ BOX_FROM_REST, at_rest


def _joint(part: int, moving: dict[int, int], place: np.ndarray, region: int, size: float) -> int:
    if part == 0:
        return int(np.array([0, 3, 6, 9])[np.searchsorted([0.045, 0.1, 0.16], place[2] / size)])
    if part == 1:
        return 15 if place[2] > 0.34 * size else 12
    if part in HANDS and region == 0:
        return HANDS[part]
    return moving[part]


def turns_at(shape: PersonShape, phase: float) -> tuple[np.ndarray, float]:
    """Rotations (24, 3, 3) in the parents' frames, the first in the box, and metres of the hips."""
    posed, frames = part_poses(shape, phase), _frames(shape)
    turns = np.tile(np.eye(3), (24, 1, 1))
    for parts, numbers in JOINTS.items():
        moved = [posed[k, :3, :3] @ frames[k, :3, :3].T for k in parts]
        chain = [moved[0], moved[0].T @ moved[1], moved[1].T @ moved[2]]
        chain += [moved[3], moved[3].T @ moved[4]]
        for joint, turn in zip(numbers, chain, strict=True):
            turns[joint] = BOX_FROM_REST.T @ turn @ BOX_FROM_REST
    turns[0] = BOX_FROM_REST
    return turns, float(posed[0, 2, 3])


def walker(
    shape: PersonShape,
    size: np.ndarray,
    trajectory: Trajectory,
    gone: np.ndarray,
    phase: float,
    times: np.ndarray | None = None,
    spacing: float = 0.03,
    noise: float = 0.0,
) -> SceneActor:
    """A person of a street with poses at some times, and metres `gone` (T,) until then.

    Args:
        noise: degrees by which every joint is off in every pose.
    """
    weights, joints, surface = skin(shape, spacing)
    times = trajectory.timestamps_us if times is None else times
    rng = np.random.default_rng(5)
    rotations, shifts = [], []
    for metres in gone:
        turns, high = turns_at(shape, phase + metres / shape.cycle)
        wrong = Rotation.from_rotvec(np.radians(noise) * rng.normal(size=(24, 3))).as_matrix()
        rotations.append(se3.matrix_to_quat(turns @ wrong))
        shifts.append(np.array([0, 0, high - size[2] / 2]) - joints[0])
    skinning = Skinning(
        torch.from_numpy(weights).float(),
        joints,
        PARENTS,
        np.asarray(times, np.int64),
        np.stack(rotations),
        np.stack(shifts),
    )
    gaussians = gaussians_of(surface, np.eye(4), COLOURS[surface.region])
    skinning.validate("made-up", len(gaussians))
    return SceneActor("7", gaussians, size, trajectory, deformation=skinning)


def write_files(folder: Path, actor: SceneActor) -> dict[str, str]:
    """Files of a walker in the format of docs/scenes.md; the settings that name them."""
    skin, poses = actor.deformation, actor.trajectory.poses
    assert isinstance(skin, Skinning) and len(poses) == len(skin.timestamps_us)
    vertices = actor.gaussians.means.double().numpy()
    turns = se3.quat_to_matrix(skin.rotations)
    turns[:, 0] = poses[:, :3, :3] @ turns[:, 0]
    vectors = Rotation.from_matrix(turns.reshape(-1, 3, 3)).as_rotvec()
    vectors = vectors.reshape(len(poses), -1, 3)
    places = se3.apply(poses, (skin.joints[0] + skin.translations)[:, None])[:, 0]
    np.savez(
        folder / "model.npz",
        v_template=vertices,
        shapedirs=np.zeros((len(vertices), 3, 1)),
        J_regressor=skin.joints @ np.linalg.pinv(vertices),
        weights=skin.weights.numpy(),
        parents=skin.parents,
    )
    parts = {
        "timestamps_us": skin.timestamps_us,
        "betas": np.zeros(1),
        "global_orient": vectors[:, 0],
        "body_pose": vectors[:, 1:],
        "transl": places - skin.joints[0],
    }
    members: dict[str, Any] = {f"{actor.track_id}/{name}": part for name, part in parts.items()}
    np.savez(folder / "poses.npz", **members)
    return {name: str(folder / f"{name[5:]}.npz") for name in ("smpl_model", "smpl_poses")}
