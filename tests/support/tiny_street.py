"""The tiny drive, trained in a few steps: fixtures of the tests of scenes and their making."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import pytest
import torch

from recast.logs import DrivingLog
from recast.reconstruction import SceneConfig, TrainingStatus, TrainResult, train_scene
from recast.splats import Gaussians

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


class KilledError(Exception):
    """A run was stopped from its progress callback."""


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


def contents(folder: Path) -> dict[str, bytes]:
    """Bytes of all files below a folder."""
    return {
        str(path.relative_to(folder)): path.read_bytes()
        for path in folder.rglob("*")
        if path.is_file()
    }


def same(first: Gaussians, second: Gaussians) -> bool:
    """Whether all values are equal."""
    pairs = zip(vars(first).values(), vars(second).values(), strict=True)
    return all(torch.equal(a, b) for a, b in pairs)


def walking(log: DrivingLog) -> DrivingLog:
    """The log, its moving car called a pedestrian."""
    return replace(log, tracks={**log.tracks, "0": replace(log.tracks["0"], category="pedestrian")})
