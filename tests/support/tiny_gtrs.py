"""A tiny GTRS model: its sizes, its views, its rig, and a vocabulary of arcs."""

from __future__ import annotations

from pathlib import Path

import numpy as np

from recast.cameras import CameraMount, PinholeCamera
from recast.cameras.mounts import camera_pose
from recast.planning.gtrs import BackboneConfig, BackboneStage, GtrsConfig, ViewLayout

GOLDEN = Path(__file__).resolve().parents[1] / "golden" / "planners"
TINY = GtrsConfig(
    backbone=BackboneConfig(
        stem=(4, 4, 8),
        stages=(
            BackboneStage(blocks=1, conv_channels=8, out_channels=16),
            BackboneStage(blocks=2, conv_channels=8, out_channels=24),
        ),
        layers=2,
    ),
    channels=32,
    feedforward=64,
    heads=4,
    decoder_layers=2,
    token_rows=2,
    token_columns=4,
)
"""The sizes of the golden tiny model, whose backbone is a stand-in."""
VIEWS = ViewLayout(
    width=48,
    height=32,
    crop_rows=4,
    crop_columns=8,
    input_width=112,
    input_height=24,
    field_of_view=61.93,
)
CAMERA = PinholeCamera(48, 32, 40.0, 40.0, 24.0, 16.0)


def rig(*names: str, scale: int = 1) -> dict[str, CameraMount]:
    """A left, front, right and rear camera with the field of view of `VIEWS`, so called."""
    camera = CAMERA.resized(48 * scale, 32 * scale)
    return {
        name: CameraMount(camera, camera_pose((1.5, 0.2, 2.1), yaw, 0.0))
        for name, yaw in zip(names, (45.0, 0.0, -45.0, 180.0), strict=False)
    }


def fan(count: int) -> np.ndarray:
    """Arcs (count, 40, 3) of several curvatures and speeds."""
    rng = np.random.default_rng(3)
    t = 0.1 * np.arange(1, 41)
    speed, curvature = rng.uniform(0, 14, (count, 1)), rng.uniform(-0.1, 0.1, (count, 1))
    s = speed * t
    x, y = np.sin(curvature * s) / curvature, (1 - np.cos(curvature * s)) / curvature
    return np.stack([x, y, curvature * s], axis=-1).astype(np.float32)
