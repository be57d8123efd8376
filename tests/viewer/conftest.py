"""A street of a few Gaussians with two arms, seen by the tiny drive, without any training."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
import torch

from recast.logs import DrivingLog, HdMap, map_of
from recast.planning import make_planner
from recast.runs.page_runner import log_runner
from recast.scene import StreetScene
from recast.scene.actor import SceneActor
from recast.scene.sky import SkyMap
from recast.simulation import MOTIONS, Rollout, RolloutSetup, camera_mounts, run_rollout
from recast.viewer import FilmFrames, ViewedDrive, ViewInputs, recording, rollout_drive
from support.gaussian_clouds import grey_gaussians
from support.own_parts import Box

TARGET = "0"


@pytest.fixture(scope="session")
def tiny_map(tiny_log: DrivingLog) -> HdMap:
    return map_of(tiny_log)


@pytest.fixture(scope="session")
def scenes(tiny_log: DrivingLog) -> dict[str, StreetScene | None]:
    """A road of grey discs, and the target as a box of two sizes; the truth has no Gaussians."""
    path = tiny_log.world_from_rig.poses[:, :3, 3]
    across = np.stack(np.meshgrid([0.0], np.arange(-6.0, 6.1, 1.0), [0.0], indexing="ij"), -1)
    road = (path[:, None] + across.reshape(1, -1, 3)).reshape(-1, 3)
    track = tiny_log.tracks[TARGET]
    body = Box().generate(None, 0).gaussians  # type: ignore[arg-type]
    actor = SceneActor(TARGET, body, track.size, track.trajectory)
    native = StreetScene(
        grey_gaussians(road, 0.4), {TARGET: actor}, SkyMap.constant(torch.tensor([0.5, 0.7, 0.9]))
    )
    smaller = replace(actor, gaussians=body.select(torch.arange(300)))
    return {"native": native, "replaced": native.with_actor(smaller), "oracle": None}


@pytest.fixture(scope="session")
def rollout(tiny_log: DrivingLog, tiny_map: HdMap) -> Rollout:
    setup = RolloutSetup(tiny_log, TARGET, MOTIONS["advancing-a"], map=tiny_map, steps=12)
    return run_rollout(setup, make_planner("idm-follower"))


@pytest.fixture(scope="session")
def drive(tiny_log: DrivingLog, tiny_map: HdMap, rollout: Rollout) -> ViewedDrive:
    """The rollout with a film of the first camera."""
    film = FilmFrames()
    for step in range(rollout.steps_run):
        film.add(np.full((24, 32, 3), 10 * step, np.uint8))
    name = next(iter(tiny_log.cameras))
    mounts = camera_mounts(tiny_log, [name])
    return rollout_drive(rollout, tiny_log, tiny_map, mounts, {name: film})


@pytest.fixture(scope="session")
def inputs(
    tiny_log: DrivingLog, tiny_map: HdMap, scenes: dict[str, StreetScene | None], drive: ViewedDrive
) -> ViewInputs:
    runner = log_runner(tiny_log, tiny_map, scenes, scenes["native"])
    return ViewInputs(
        "tiny_run",
        scenes,
        {"advancing-a": dict.fromkeys(scenes, drive), "recording": {"native": recording(tiny_log)}},
        tiny_log,
        tiny_map,
        runner=replace(runner, steps=10),
    )
