"""A generator that takes no time, named module:attribute."""

from __future__ import annotations

import numpy as np
import torch

from recast.actors.axes import VEHICLE
from recast.actors.generate import Asset
from recast.actors.observation import Observation
from recast.splats import Gaussians


class Box:
    """An upright box of Gaussians with the proportions of a car."""

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
