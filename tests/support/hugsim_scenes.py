"""A street as HUGSIM publishes it."""

from __future__ import annotations

import json
import math
import pickle
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import torch
from scipy.spatial.transform import Rotation

from recast.geometry import se3
from recast.logs import CameraStream, DrivingLog
from recast.splats import Gaussians
from support import trained_scenes as made

FIRST = 1  # the scene begins with this frame of the log's camera
SCENE_FROM_WORLD = se3.inverse(made.world_from_rig(FIRST) @ made.RIG_FROM_CAMERA)
RIGHT_FORWARD_UP = np.array([[0.0, -1, 0], [1, 0, 0], [0, 0, 1]])  # own axes of forward, left, up
FORWARD_DOWN_LEFT = np.array([[1.0, 0, 0], [0, 0, -1], [0, 1, 0]])
BACK = made.RIG_FROM_CAMERA.copy()
BACK[:3, :3] = se3.rotation_z(np.pi) @ BACK[:3, :3]


def make_log(tracks: bool = True) -> DrivingLog:
    """The drive with a front camera and one that looks back; neither has images."""
    log = made.make_log()
    cameras = {
        name: CameraStream(name, made.CAMERA, pose, made.TIMES, [None] * made.FRAMES)  # type: ignore[arg-type]
        for name, pose in (("back", BACK), ("front", made.RIG_FROM_CAMERA))
    }
    return replace(log, cameras=cameras, tracks=log.tracks if tracks else {})


def own_pose(world_from_actor: np.ndarray, actor_axes: np.ndarray) -> np.ndarray:
    """The pose in the scene of an actor whose own axes are others."""
    turn = se3.from_rotation_translation(actor_axes, np.zeros(3))
    return SCENE_FROM_WORLD @ world_from_actor @ se3.inverse(turn)


def in_own_axes(seed: int, actor_axes: np.ndarray) -> Gaussians:
    """A car in its own axes; its harmonics are in the axes of the scene."""
    turn = se3.from_rotation_translation(actor_axes, np.zeros(3))
    return made.moved(made.make_car(3, seed), turn, True)


def make_ground() -> Gaussians:
    ground = made.make_gaussians(90, np.array([0.0, 1.4, 12.0]), np.array([20.0, 0, 30.0]), 3, 8)
    ground.log_scales[:, 1] = math.log(0.001)
    return replace(ground, quats=torch.tensor([[1.0, 0, 0, 0]]).repeat(90, 1))


def members(gaussians: Gaussians, sides: Any = slice(None)) -> tuple[Any, ...]:
    n = len(gaussians)
    return (
        gaussians.sh_degree,
        torch.nn.Parameter(gaussians.means),
        gaussians.sh[:, :1].clone(),
        gaussians.sh[:, 1:].clone(),
        torch.zeros(n, 20),
        gaussians.log_scales[:, sides].clone(),
        gaussians.quats,
        gaussians.logit_opacities[:, None],
    )


def unicycle(poses: np.ndarray, times: np.ndarray) -> tuple[torch.Tensor, ...]:
    # About fixed axes, x first, then z, then y, as the published renderer puts them together.
    angles = np.pi / 2 - Rotation.from_matrix(poses[:, :3, :3]).as_euler("xzy")
    rest = torch.zeros(len(times))
    lean, yaw = torch.from_numpy(angles[:, :2]), torch.from_numpy(angles[:, 2])
    across, height, along = torch.from_numpy(poses[:, :3, 3]).T
    return across, along, rest, lean, yaw, height, torch.from_numpy(times), rest[1:]


def background() -> Gaussians:
    return made.moved(made.make_background(3), SCENE_FROM_WORLD, False)


def write(
    folder: Path,
    scene: Any = None,
    ground: Any = None,
    commands: Any = None,
    car: Any = None,
    motion: Any = None,
    poses: Any = None,
    meta: Any = None,
) -> Path:
    folder.mkdir(parents=True)
    if scene is None:
        flat = members(make_ground(), [0, 2]) if ground is None else ground
        scene = (*members(background()), 1.0, {"params": torch.zeros(4)}, flat)
    torch.save((scene, 30000), folder / "scene.pth")
    frames = range(FIRST, made.FRAMES)
    seconds = 0.1 * np.arange(made.FRAMES - FIRST) + 7.0
    if poses is None:
        poses = np.stack(
            [SCENE_FROM_WORLD @ made.world_from_rig(f) @ made.RIG_FROM_CAMERA for f in frames]
        )
    ground_param = (poses, 1.5, commands if commands is not None else [2] * len(poses))
    (folder / "ground_param.pkl").write_bytes(pickle.dumps(ground_param))
    images = [
        {
            "rgb_path": f"./images/{name}/{frame:03d}.jpg",
            "camtoworld": (SCENE_FROM_WORLD @ made.world_from_rig(frame) @ mount).tolist(),
            "intrinsics": made.CAMERA.matrix.tolist(),
            "width": made.CAMERA.width,
            "height": made.CAMERA.height,
            "timestamp": float(second),
        }
        for frame, second in zip(frames, seconds, strict=True)
        for name, mount in (("CAM_BACK", BACK), ("CAM_FRONT", made.RIG_FROM_CAMERA))
    ]
    meta = {"frames": images[::-1]} if meta is None else meta
    (folder / "meta_data.json").write_text(json.dumps(meta))
    for name, true, axes, seed in (
        ("12", made.world_from_car, RIGHT_FORWARD_UP, 3),
        ("7", made.world_from_parked, FORWARD_DOWN_LEFT, 2),
    ):
        own = (*members(in_own_axes(seed, axes)), 1.0) if car is None else car
        torch.save((own, 30000), folder / f"dynamic_{name}.pth")
        placed = np.stack([own_pose(true(frame), axes) for frame in frames])
        kept = unicycle(placed, seconds) if motion is None else motion
        torch.save(kept, folder / f"unicycle_{name}.pth")
    return folder
