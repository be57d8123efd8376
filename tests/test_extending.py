"""One small part of each kind by which recast is extended; docs/architecture.md shows them."""

from __future__ import annotations

import re
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest
import torch

import recast
from recast.actors import Asset, Observation
from recast.actors.generate import VEHICLE
from recast.cameras import CameraMount
from recast.geometry import se3
from recast.logs import DrivingLog, HdMap
from recast.metrics import Metric
from recast.planning import Plan, PlannerInput, PlanningContext
from recast.simulation import Rollout, SimState, StartSituation, camera_mounts
from recast.splats import Gaussians


# --8<-- [start:importer]
def own_importer(root: Path, drive: str, **options: Any) -> DrivingLog:
    """An importer: any function of a folder and a drive that returns a `DrivingLog`."""
    return replace(recast.load_log(root), name=drive)


# --8<-- [end:importer]


# --8<-- [start:planner]
class Coasting:
    """A planner: keeps the speed, straight ahead."""

    name = "coasting"
    needs_images = False

    def reset(self, context: PlanningContext) -> None:
        """Nothing is kept between plans."""

    def plan(self, observation: PlannerInput) -> Plan:
        """Waypoints (40, 3) in the ego frame, at 0.1 s to 4.0 s."""
        waypoints = np.zeros((40, 3))
        waypoints[:, 0] = observation.ego.vx * np.arange(1, 41) * 0.1
        return Plan(waypoints)


# --8<-- [end:planner]


# --8<-- [start:metric]
class HardestBraking:
    """A metric: value and reason, from the states of a rollout."""

    name = "hardest_braking_mps2"

    def score(self, rollout: Rollout, hd_map: HdMap | None) -> Metric:
        """Least acceleration along the heading, m/s^2."""
        least = float(rollout.ego[:, 5].min())
        return Metric(least, None if least > -4.05 else f"brakes with {-least:.1f} m/s^2")


# --8<-- [end:metric]


# --8<-- [start:motion]
@dataclass(frozen=True)
class Standing:
    """A scripted motion: the actor stands where it was at the start."""

    name: str = "standing"
    setting: str = "a"

    def script(self, start: StartSituation, steps: int, dt: float) -> np.ndarray:
        """States (steps + 1, 4): x, y, heading, speed."""
        assert start.trajectory is not None
        pose = start.trajectory.at(start.start_timestamp_us)
        return np.tile([*pose[:2, 3], se3.yaw(pose), 0.0], (steps + 1, 1))


# --8<-- [end:motion]


# --8<-- [start:generator]
class Block:
    """A generator: a block of grey Gaussians in the size of the logged box."""

    name = "block"

    def generate(self, observation: Observation, seed: int) -> Asset:
        """A vehicle that is complete from every side."""
        means = torch.rand(500, 3, generator=torch.Generator().manual_seed(seed)) - 0.5
        gaussians = Gaussians(
            means=means * torch.tensor([4.5, 1.8, 1.5]),
            quats=torch.tensor([1.0, 0.0, 0.0, 0.0]).repeat(500, 1),
            log_scales=torch.full((500, 3), -2.5),
            logit_opacities=torch.full((500,), 4.0),
            sh=torch.zeros(500, 1, 3),
        )
        return Asset(gaussians, VEHICLE, self.name, seed)


# --8<-- [end:generator]


# --8<-- [start:renderer]
class Grey:
    """A renderer: a grey image for every camera."""

    def __init__(self, log: DrivingLog) -> None:
        self.mounts: Mapping[str, CameraMount] = camera_mounts(log, scale=0.25)

    def render(self, state: SimState, camera_names: Sequence[str]) -> dict[str, np.ndarray]:
        """Images (H, W, 3) uint8 RGB."""
        cameras = {name: self.mounts[name].camera for name in camera_names}
        return {name: np.full((c.height, c.width, 3), 128, np.uint8) for name, c in cameras.items()}


# --8<-- [end:renderer]


def test_the_page_shows_them() -> None:
    page = (Path(__file__).parents[1] / "docs" / "architecture.md").read_text()
    names = re.findall(r"^# --8<-- \[start:(\w+)\]", Path(__file__).read_text(), re.MULTILINE)
    for name in names:
        assert f'--8<-- "tests/test_extending.py:{name}"' in page, name
    assert len(names) == 6


@pytest.fixture(scope="module")
def log(tiny_log_folder: Path) -> DrivingLog:
    return recast.load_log(tiny_log_folder, importer=own_importer, drive="mine")


def test_importer(log: DrivingLog) -> None:
    assert log.name == "mine" and "0" in log.tracks


def test_planner_motion_renderer_and_metric(log: DrivingLog) -> None:
    sim = recast.Simulator(
        log, Grey(log), {"0": Standing()}, settings=recast.RolloutSettings(steps=10)
    )
    planner = recast.make_planner(Coasting())
    planner.reset(sim.context)
    observation = sim.reset()
    camera = next(iter(log.cameras))
    assert observation.images[camera].max() == 128
    while not sim.done:
        observation = sim.step(planner.plan(observation))
    assert np.ptp(sim.rollout.actor[:, :2], axis=0).max() == 0
    scored = recast.score(sim.rollout, metrics=[HardestBraking()])
    assert scored.values["hardest_braking_mps2"].valid


def test_generator_and_arm(tiny_log_folder: Path, tmp_path: Path) -> None:
    arm = tmp_path / "arms.yaml"
    arm.write_text(f"[{{name: block, vehicle: generated, generator: '{__name__}:Block'}}]")
    grid = recast.run_grid(
        [f"{tiny_log_folder}:0"],
        tmp_path / "grid",
        arms=["native", str(arm)],
        steps=10,
        motions=["advancing-a"],
        samples=100,
        iterations=4,
        scale=0.5,
        refine=False,
    )
    assert [line.row.arm for line in grid.table] == ["native", "block"]
