"""Occlusion by a pole: lamp posts, signs, trunks."""

from __future__ import annotations

from typing import ClassVar

import numpy as np

from recast.recar.perturb.extent import find_object
from recast.recar.perturb.kind import Kind, Picture, Positive, Share, Weight
from recast.recar.perturb.occlude import occlude

_COLOURS = np.array(
    [(0.45, 0.46, 0.47), (0.2, 0.21, 0.2), (0.33, 0.26, 0.2), (0.65, 0.65, 0.62)], np.float32
)


class Pole(Kind):
    """An upright band from top to bottom, somewhere across the object.

    Attributes:
        width: at severity 1, over the extent.
        lean_deg: standard deviation of its slope, degrees.
        fringe: widest edge that the mask keeps, over the extent.
    """

    name: ClassVar[str] = "pole"

    weight: Weight = 1 / 3
    width: Positive = 0.14
    lean_deg: Positive = 2.0
    fringe: Share = 0.012

    def __call__(self, rgba: Picture, severity: float, rng: np.random.Generator) -> Picture:
        """Spoil a picture; see `Perturbation`."""
        height, width = rgba.shape[:2]
        box = find_object(rgba)
        across = box.left + rng.uniform(0.1, 0.9) * box.width
        lean = np.tan(np.radians(self.lean_deg) * rng.standard_normal())
        colour = _COLOURS[rng.integers(len(_COLOURS))]
        fringe = rng.uniform(0, self.fringe) * box.extent
        rows = np.arange(height, dtype=np.float32)[:, None] - box.top - box.height / 2
        columns = np.arange(width, dtype=np.float32)[None, :] + 0.5
        half = severity * self.width * box.extent / 2
        offset = np.abs(columns - across - lean * rows)
        coverage = np.clip(half + 0.5 - offset, 0, min(1, 2 * half)).astype(np.float32)
        return occlude(rgba, coverage, colour, fringe)
