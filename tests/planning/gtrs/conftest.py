"""A tiny model with known answers, and a planner around it that needs no vocabulary of others."""

from __future__ import annotations

import json
from pathlib import Path

import numpy as np
import pytest
import torch
from safetensors.torch import load_file

from recast.cameras import CameraMount, PinholeCamera
from recast.cameras.mounts import camera_pose
from recast.planning.gtrs import (
    BackboneConfig,
    BackboneStage,
    GtrsConfig,
    GtrsModel,
    GtrsPlanner,
    ViewLayout,
    new_model,
)

GOLDEN = Path(__file__).resolve().parents[2] / "golden" / "planners"

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


@pytest.fixture(scope="session")
def tiny_io() -> dict[str, torch.Tensor]:
    return load_file(GOLDEN / "gtrs_tiny_io.safetensors")


@pytest.fixture(scope="session")
def tiny_weights() -> dict[str, torch.Tensor]:
    return load_file(GOLDEN / "gtrs_tiny_weights.safetensors")


@pytest.fixture
def tiny_model(tiny_weights: dict[str, torch.Tensor]) -> GtrsModel:
    """The golden head behind a backbone that has made-up weights."""
    model = new_model(TINY, torch.Generator().manual_seed(0))
    result = model.load_state_dict(tiny_weights, strict=False)
    assert all(name.startswith("_backbone.") for name in result.missing_keys)
    return model


@pytest.fixture(scope="session")
def released_vocabulary(shared: Path) -> torch.Tensor:
    """The 8192 published trajectories; they are not ours to copy."""
    return torch.from_numpy(np.load(shared / "golden" / "planners" / "vocab_8192.npy"))


@pytest.fixture(scope="session")
def tiny_vocabulary(released_vocabulary: torch.Tensor) -> torch.Tensor:
    """The 64 of them that the golden tiny model scores."""
    return released_vocabulary[::128]


@pytest.fixture
def planner() -> GtrsPlanner:
    model = new_model(TINY, torch.Generator().manual_seed(1))
    return GtrsPlanner(model, fan(12), VIEWS, name="tiny", top_k=3)


@pytest.fixture
def released_keys() -> dict[str, tuple[int, ...]]:
    keys = json.loads((GOLDEN / "gtrs_keys.json").read_text())
    return {name: tuple(shape) for name, shape in keys.items()}
