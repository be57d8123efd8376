"""A mask in steps: drawn by a segmenter on a coarse grid."""

from __future__ import annotations

from typing import ClassVar

import cv2
import numpy as np

from recast.recar.perturb.backdrop import backdrop
from recast.recar.perturb.extent import find_object
from recast.recar.perturb.kind import Kind, Picture, Positive, Weight
from recast.recar.perturb.premultiplied import colour_and_alpha
from recast.recar.perturb.reveal import reveal


class Jagged(Kind):
    """Square steps along the edge; some of the object is lost and some background comes in.

    Attributes:
        cell: of the grid at severity 1, over the extent.
    """

    name: ClassVar[str] = "jagged"

    weight: Weight = 0.2
    cell: Positive = 0.04

    def __call__(self, rgba: Picture, severity: float, rng: np.random.Generator) -> Picture:
        """Spoil a picture; see `Perturbation`."""
        height, width = rgba.shape[:2]
        box = find_object(rgba)
        street = backdrop(rgba, box, rng)
        cell = severity * self.cell * box.extent
        if cell <= 1:
            return rgba.copy()
        _, alpha = colour_and_alpha(rgba)
        size = (max(round(width / cell), 1), max(round(height / cell), 1))
        small = cv2.resize(alpha, size, interpolation=cv2.INTER_AREA)
        steps = (small > rng.uniform(0.35, 0.65, small.shape)).astype(np.float32)
        mask = cv2.resize(steps, (width, height), interpolation=cv2.INTER_NEAREST)
        return reveal(rgba, np.asarray(mask, np.float32), street)
