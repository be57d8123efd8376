"""Parts of a user's own, named module:attribute: planners that fail, and one part of other kinds.

They lie in a module of their own: what a user's module imports from beside it is read by every
command that names the part.
"""

from __future__ import annotations

import os
import signal
from collections.abc import Mapping
from pathlib import Path

import numpy as np
import torch

from recast.actors.generate import VEHICLE, Asset
from recast.actors.observation import Observation
from recast.arrays import Image
from recast.logs import HdMap
from recast.metrics import Metric
from recast.planning import Plan, PlannerInput, PlanningContext
from recast.planning.simple import IdmLaneFollower
from recast.simulation import Rollout
from recast.splats import Gaussians


class Box:
    """A generator that takes no time: an upright box of Gaussians with the proportions of a car."""

    name = "box"

    def generate(self, observation: Observation, seed: int) -> Asset:
        rng = np.random.default_rng(seed)
        points = rng.uniform(-1, 1, (600, 3))
        face = rng.integers(3, size=600)
        points[np.arange(600), face] = np.sign(points[np.arange(600), face])
        means = torch.tensor(points * [2.1, 0.85, 0.7], dtype=torch.float32)
        return Asset(
            Gaussians(
                means,
                torch.tensor([[1.0, 0.0, 0.0, 0.0]]).repeat(600, 1),
                torch.full((600, 3), float(np.log(0.08))),
                torch.full((600,), 4.0),
                means[:, None] * 0.5,
            ),
            VEHICLE,
            self.name,
            seed,
        )


class Negative:
    """Turns every image into its negative."""

    name = "negative"

    def restore(self, images: Mapping[str, Image]) -> dict[str, Image]:
        return {name: np.uint8(255) - image for name, image in images.items()}


class LeastGap:
    """A metric: metres between the centres of ego and target, at least."""

    name = "least_gap_m"

    def score(self, rollout: Rollout, hd_map: HdMap | None) -> Metric:
        gaps = np.linalg.norm(rollout.ego[:, :2] - rollout.actor[:, :2], axis=1)
        return Metric(gaps.min(), f"at step {gaps.argmin()}")


class Faulty(IdmLaneFollower):
    """Follows its lane once, and then fails somehow."""

    name = "faulty"
    needs_images = False
    fault = "raise"

    def plan(self, observation: PlannerInput) -> Plan:
        if observation.step < 5:
            return super().plan(observation)
        if self.fault == "raise":
            raise RuntimeError("no idea what to do")
        waypoints = super().plan(observation).waypoints.copy()
        if self.fault == "nan":
            waypoints[3] = np.nan
        return Plan(waypoints[:20] if self.fault == "few" else waypoints)


class Sampling(IdmLaneFollower):
    """Drives by chance a little slower than the follower."""

    name = "sampling"

    def plan(self, observation: PlannerInput) -> Plan:
        slower = np.random.uniform(0.8, 1.0)  # noqa: NPY002  # as planners of others do
        return Plan(slower * super().plan(observation).waypoints)


class NotANumber(Faulty):
    fault = "nan"


class TooFew(Faulty):
    fault = "few"


class Kills(IdmLaneFollower):
    """Ends its process at the third rollout that it is asked for, once."""

    name = "idm-follower"

    def reset(self, context: PlanningContext) -> None:
        super().reset(context)
        marker = Path(os.environ["RECAST_TEST_KILLS"])
        begun = int(marker.read_text()) if marker.exists() else 0
        marker.write_text(str(begun + 1))
        if begun == 2:
            os.kill(os.getpid(), signal.SIGKILL)
