"""A trained scene as DriveStudio saves it."""

from __future__ import annotations

from typing import Any

import numpy as np
import torch

from recast.geometry import se3
from support import trained_scenes as made

FIRST = 2  # the training began with this frame of the log
COUNT = made.FRAMES - FIRST
WORLD_FROM_SCENE = made.world_from_rig(FIRST)
SCENE_FROM_WORLD = se3.inverse(WORLD_FROM_SCENE)
SKY_FROM_SCENE = np.array([[1.0, 0, 0], [0, 0, 1], [0, -1, 0]])
SHIFT = np.array([0.1, -0.15, 0.05])  # what training moved the boxes by


def scene_from_instance(index: int, frame: int) -> np.ndarray:
    true = (made.world_from_parked, made.world_from_car)[index](frame)
    pose = SCENE_FROM_WORLD @ true
    pose[:3, 3] += SHIFT
    return pose


def affine_network() -> dict[str, torch.Tensor]:
    generator = torch.Generator().manual_seed(5)
    return {
        "embedding.weight": torch.randn(7, 4, generator=generator),
        "decoder.0.weight": torch.randn(64, 4, generator=generator),
        "decoder.0.bias": 0.1 * torch.randn(64, generator=generator),
        "decoder.2.weight": 0.004 * torch.randn(12, 64, generator=generator),
        "decoder.2.bias": 0.01 * torch.randn(12, generator=generator),
    }


def mean_affine() -> np.ndarray:
    net = {name: value.numpy() for name, value in affine_network().items()}
    hidden = np.maximum(
        net["decoder.0.weight"] @ net["embedding.weight"].mean(0) + net["decoder.0.bias"], 0
    )
    residual = net["decoder.2.weight"] @ hidden + net["decoder.2.bias"]
    return np.eye(3, 4) + residual.reshape(3, 4)


def checkpoint(**changes: Any) -> dict[str, Any]:
    """Instance 0 is the parked car, 1 the moving one (absent in the first frame), 2 never there."""
    poses = np.stack(
        [[scene_from_instance(i, f) for i in (0, 1)] for f in range(FIRST, FIRST + COUNT)]
    )
    quats = np.zeros((COUNT, 3, 4))
    places = np.zeros((COUNT, 3, 3))
    quats[:, :2], places[:, :2] = 2 * se3.matrix_to_quat(poses[..., :3, :3]), poses[..., :3, 3]
    present = torch.ones(COUNT, 3, dtype=torch.bool)
    present[0, 1] = present[:, 2] = False
    first, second = (made.drivestudio_part(made.make_car(3, seed)) for seed in (2, 3))
    rigid = {name: torch.cat([first[name], second[name]]) for name in first} | {
        "instances_quats": torch.from_numpy(quats).float(),
        "instances_trans": torch.from_numpy(places).float(),
        "points_ids": torch.cat([torch.zeros(80, 1), torch.ones(80, 1)]).long(),
        "instances_size": torch.tensor([[4.2, 1.8, 1.6]] * 3),
        "instances_fv": present,
    }
    background = made.moved(made.make_background(3), SCENE_FROM_WORLD, False)
    models = {
        "Background": made.drivestudio_part(background),
        "RigidNodes": rigid,
        "Sky": {"base": made.make_cubemap()},
        "Affine": affine_network(),
        "CamPose": {"embeds.weight": torch.zeros(7, 9)},
        "DeformableNodes": {"_means": torch.zeros(3, 3)},
        "SMPLNodes": {"_means": torch.zeros(3, 3)},
    }
    return {
        "step": 30000,
        "models": {k: v for k, v in (models | changes).items() if v is not None},
        "lpips.net.weight": torch.zeros(2),
    }
