"""A small street with a log of two cameras, as a renderer serves it; a server on a free port."""

from __future__ import annotations

from collections.abc import Iterator
from contextlib import contextmanager
from typing import Any

import numpy as np
import torch

from recast.cameras import CameraMount, PinholeCamera
from recast.geometry import se3
from recast.logs.types import CameraStream, DrivingLog, Track, Trajectory
from recast.scene.actor import SceneActor
from recast.scene.sky import SkyMap
from recast.scene.street_scene import StreetScene
from recast.splats import Gaussians
from recast_bridges.alpasim.server import SensorsimServer, SensorsimService
from recast_bridges.rendering import ScenePainter, ServedScene, Unnamed

SCENE = "drive"
MOVING, PARKED = "car-a", "car-b"
CAMERA = PinholeCamera(48, 32, 30.0, 30.0, 24.0, 16.0)
BENT = PinholeCamera(40, 30, 30.0, 30.0, 20.0, 15.0, (-0.2, 0.02, 0.001, -0.001, 0.0))
RIG_FROM_CAMERA = se3.from_rotation_translation(
    [[0.0, 0.0, 1.0], [-1.0, 0.0, 0.0], [0.0, -1.0, 0.0]], [1.5, 0.0, 1.5]
)
TIMES = 5_000_000 + 100_000 * np.arange(201)
MOUNTS = {
    "front": CameraMount(CAMERA, RIG_FROM_CAMERA),
    "bent": CameraMount(BENT, RIG_FROM_CAMERA),
}


class NoImages:
    """Frames that nobody asks for."""

    def __len__(self) -> int:
        return 0

    def __getitem__(self, index: int) -> np.ndarray:
        raise IndexError(index)


def ahead(metres: np.ndarray, left: float) -> np.ndarray:
    """Poses (T, 4, 4) along x at a height of 0.8 m."""
    places = np.stack([metres, np.full_like(metres, left), np.full_like(metres, 0.8)], axis=-1)
    return se3.from_rotation_translation(np.eye(3), places)


def make_log() -> DrivingLog:
    """The ego drives at 8 m/s, a car at the same speed 15 m ahead of it; another one is parked."""
    along = 0.8 * np.arange(201.0)
    ego = ahead(along, 0.0)
    ego[:, 2, 3] = 0.0
    size = np.array([4.2, 1.8, 1.6])
    parked = Trajectory(TIMES[[0, -1]], ahead(np.array([14.0, 14.0]), 4.0))
    tracks = {
        MOVING: Track(MOVING, "car", size, Trajectory(TIMES, ahead(along + 15.0, -2.0))),
        PARKED: Track(PARKED, "car", size, parked),
    }
    none = np.zeros(0, np.int64)
    cameras = {
        name: CameraStream(name, mount.camera, mount.rig_from_camera, none, NoImages())
        for name, mount in MOUNTS.items()
    }
    return DrivingLog(SCENE, cameras, {}, Trajectory(TIMES, ego), tracks)


def make_gaussians(count: int, low: list[float], high: list[float], seed: int) -> Gaussians:
    """Random Gaussians in a box."""
    generator = torch.Generator().manual_seed(seed)

    def uniform(*shape: int) -> torch.Tensor:
        return torch.rand(*shape, generator=generator)

    box = torch.tensor([low, high])
    return Gaussians(
        means=box[0] + uniform(count, 3) * (box[1] - box[0]),
        quats=uniform(count, 4) - 0.5,
        log_scales=uniform(count, 3) - 1.5,
        logit_opacities=4.0 * uniform(count),
        sh=torch.cat([2.0 * uniform(count, 1, 3) - 1.0, 0.3 * uniform(count, 3, 3) - 0.15], dim=1),
    )


def make_scene(log: DrivingLog) -> StreetScene:
    """A street along the drive with both cars."""
    actors = {
        key: SceneActor(
            key, make_gaussians(80, [-2, -0.9, -0.8], [2, 0.9, 0.8], seed), track.size,
            track.trajectory,
        )
        for seed, (key, track) in enumerate(log.tracks.items())
    }  # fmt: skip
    street = make_gaussians(1500, [0, -8, -0.5], [180, 8, 0.5], 9)
    return StreetScene(
        street, actors, SkyMap.constant(torch.tensor([0.3, 0.5, 0.8])), log_name=SCENE
    )


def served(world_from_local: np.ndarray | None = None) -> dict[str, ServedScene]:
    """The street under its name."""
    world = np.eye(4) if world_from_local is None else world_from_local
    return {SCENE: ServedScene(make_scene(make_log()), MOUNTS, world)}


@contextmanager
def serving(
    unnamed: Unnamed = "hidden", painter: ScenePainter | None = None, **options: Any
) -> Iterator[SensorsimServer]:
    """A server of the street; `.port` says where."""
    painter = painter or ScenePainter(served(), "cpu", unnamed)
    with SensorsimServer(
        SensorsimService(painter), **{"port": 0, "workers": 4, **options}
    ) as server:
        yield server
