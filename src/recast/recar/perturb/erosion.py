"""A mask too small: its edge lies within the object."""

from __future__ import annotations

from typing import ClassVar

import numpy as np

from recast.recar.perturb.extent import find_object
from recast.recar.perturb.kind import Kind, Picture, Positive, Weight
from recast.recar.perturb.premultiplied import colour_and_alpha, with_alpha
from recast.recar.perturb.signed_distance import signed_distance
from recast.recar.perturb.value_noise import value_noise


class Erosion(Kind):
    """An edge that moves inwards, further in some places than in others; mirrors and tyres go.

    Attributes:
        depth: mean distance at severity 1, over the extent.
    """

    name: ClassVar[str] = "erosion"

    weight: Weight = 0.2
    depth: Positive = 0.025

    def __call__(self, rgba: Picture, severity: float, rng: np.random.Generator) -> Picture:
        """Spoil a picture; see `Perturbation`."""
        height, width = rgba.shape[:2]
        extent = find_object(rgba).extent
        uneven = np.clip(1 + 0.6 * value_noise(height, width, 0.15 * extent, rng), 0, 3)
        colour, alpha = colour_and_alpha(rgba)
        inwards = severity * self.depth * extent * uneven
        # Ramp a pixel wide, that leaves soft edges alone where nothing is eroded.
        kept = np.clip(signed_distance(alpha) - inwards + 1.5, 0, 1)
        return with_alpha(colour, alpha * kept)
