"""A small training run that the tests of this folder share."""

from __future__ import annotations

from pathlib import Path

import pytest

from recast.logs import DrivingLog
from recast.reconstruction import SceneConfig, TrainingStatus, TrainResult, train_scene

TINY = SceneConfig(
    scale=1.0,
    iterations=60,
    sweep_points=2000,
    voxel_m=0.4,
    densify_every=20,
    evaluate_every=20,
    checkpoint_every=15,
    threads=1,
)


@pytest.fixture(scope="session")
def told() -> list[TrainingStatus]:
    """What the shared run told about itself."""
    return []


@pytest.fixture(scope="session")
def trained(
    tiny_log: DrivingLog,
    tmp_path_factory: pytest.TempPathFactory,
    told: list[TrainingStatus],
) -> TrainResult:
    """The tiny drive reconstructed in 60 steps."""
    folder: Path = tmp_path_factory.mktemp("trained") / "scene"
    return train_scene(tiny_log, folder, TINY, progress=told.append)
