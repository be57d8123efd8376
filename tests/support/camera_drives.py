"""A made-up drive with a front camera, and a street of one ball a track."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import torch

from recast.cameras import PinholeCamera
from recast.geometry import se3
from recast.logs.types import CameraStream, DrivingLog
from recast.splats import Gaussians
from support.synthetic_drives import drive

CAMERA = PinholeCamera(64, 48, 40.0, 40.0, 32.0, 24.0)
# optical axis along the rig's x, 1.5 m above the ground
RIG_FROM_CAMERA = se3.from_rotation_translation(
    [[0.0, 0.0, 1.0], [-1.0, 0.0, 0.0], [0.0, -1.0, 0.0]], [1.5, 0.0, 1.0]
)


class NoImages:
    def __len__(self) -> int:
        return 0

    def __getitem__(self, index: int) -> np.ndarray:
        raise IndexError(index)


def log_with_camera() -> DrivingLog:
    stream = CameraStream("front", CAMERA, RIG_FROM_CAMERA, np.zeros(0, np.int64), NoImages())
    return replace(drive(), cameras={"front": stream})


def ball(colour: tuple[float, float, float], at: tuple[float, float, float]) -> Gaussians:
    return Gaussians(
        means=torch.tensor([at], dtype=torch.float32),
        quats=torch.tensor([[1.0, 0.0, 0.0, 0.0]]),
        log_scales=torch.full((1, 3), -0.7),
        logit_opacities=torch.tensor([8.0]),
        sh=((torch.tensor(colour) - 0.5) / 0.28209479).reshape(1, 1, 3),
    )
