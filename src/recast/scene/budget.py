"""How many Gaussians a scene may have: by the street's area, and by the pixels that tell of them.

A street needs a number for each square metre; beyond it, more of them hardly sharpen what cameras a
few metres away see. Images that hold few pixels cannot tell where more belong. The smaller of the
two counts, unless the configuration names a number. The first points may take `FIRST_SHARE` of it,
so that growth always has room.

Both constants come from trials on a synthetic street that no table of the docs measures
(`arterial-median`, seed 71, 5 s, held-out PSNR). Three cameras of 384x256, 1200 steps, by Gaussians
a square metre: 7: 28.5 dB, 14: 29.6, 27: 30.3, 41 (all that growth asked for): 30.4. One camera of
192x128, 1000 steps, by pixels a Gaussian: 108: 28.2 dB, 54: 29.3, 27: 29.8, 14: 30.2.
"""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from recast.records import Record
from recast.scene.config import SceneConfig
from recast.scene.views import View
from recast.storage import write_json

BUDGET_FILE = "budget.json"
BUDGET_VERSION = 1

REACH_M = 25.0
"""Metres of street to either side of the drive that are counted."""
EACH_M2 = 48.0
"""Gaussians per square metre of street."""
PIXELS_EACH = 16.0
"""Pixels of the training images per Gaussian."""
LEAST = 20_000
"""Smallest limit that is derived."""
FIRST_SHARE = 2 / 3
"""Share of the limit that the first points may take."""
_CELL_M = 5.0


class Budget(Record):
    """Contents of budget.json: how many Gaussians there may be, and what came of it.

    Attributes:
        most_gaussians: the limit.
        named: whether the configuration named it; else it was derived from the next two.
        area_m2: street within `REACH_M` of the drive.
        training_pixels: pixels of all training images at the scale of the training.
        first_found, first_kept: first points before and after they were thinned to the limit.
        limited_from: step of the first change of the population that the limit cut short, or None.
        limited_changes: number of changes that the limit cut short.
    """

    version: int = BUDGET_VERSION
    most_gaussians: int
    named: bool
    area_m2: float
    training_pixels: int
    first_found: int = 0
    first_kept: int = 0
    limited_from: int | None = None
    limited_changes: int = 0

    @property
    def was_met(self) -> bool:
        """Whether the limit kept anything from being added."""
        return self.limited_changes > 0 or self.first_kept < self.first_found

    def explain(self) -> str:
        """One line for people."""
        how = "max_gaussians"
        if not self.named:
            pixels = self.training_pixels / 1e6
            how = f"from {self.area_m2:,.0f} m2 of street and {pixels:,.1f} million pixels"
        told = f"limit of {self.most_gaussians:,} Gaussians ({how})"
        if not self.was_met:
            return f"{told}: not met"
        parts = []
        if self.first_kept < self.first_found:
            parts.append(f"first points thinned from {self.first_found:,} to {self.first_kept:,}")
        if self.limited_from is not None:
            parts.append(f"{self.limited_changes} changes cut short from step {self.limited_from}")
        return f"{told}: {', '.join(parts)}"


def gaussian_budget(config: SceneConfig, views: Sequence[View]) -> Budget:
    """The limit for a training on `views`; those held out do not count."""
    training = [view for view in views if not view.held_out]
    pixels = sum(view.camera.width * view.camera.height for view in training)
    area = street_area(np.array([view.world_from_camera[:2, 3] for view in training]))
    derived = max(LEAST, int(min(EACH_M2 * area, pixels / PIXELS_EACH)))
    return Budget(
        most_gaussians=config.max_gaussians or derived,
        named=config.max_gaussians is not None,
        area_m2=area,
        training_pixels=pixels,
    )


def street_area(positions: NDArray[np.float64]) -> float:
    """Square metres within `REACH_M` of any position (N, 2), in cells of 5 m."""
    steps = np.arange(-REACH_M, REACH_M + _CELL_M, _CELL_M)
    offsets = np.stack(np.meshgrid(steps, steps), axis=-1).reshape(-1, 2)
    offsets = offsets[np.linalg.norm(offsets, axis=1) <= REACH_M]
    near = np.unique(np.floor(positions / _CELL_M), axis=0) * _CELL_M
    cells = np.unique((near[:, None] + offsets).reshape(-1, 2), axis=0)
    return float(len(cells) * _CELL_M**2)


def write_budget(budget: Budget, folder: Path) -> None:
    """Write budget.json into a scene folder."""
    write_json(folder / BUDGET_FILE, budget.model_dump(mode="json"))
