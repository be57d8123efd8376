"""A mask too large: a rim of background around the object."""

from __future__ import annotations

from typing import ClassVar

import numpy as np

from recast.recar.perturb.backdrop import backdrop
from recast.recar.perturb.extent import find_object
from recast.recar.perturb.kind import Kind, Picture, Positive, Weight
from recast.recar.perturb.premultiplied import colour_and_alpha
from recast.recar.perturb.reveal import reveal
from recast.recar.perturb.signed_distance import signed_distance
from recast.recar.perturb.value_noise import value_noise


class Dilation(Kind):
    """An edge that moves outwards, further in some places than in others.

    Attributes:
        depth: mean distance at severity 1, over the extent.
    """

    name: ClassVar[str] = "dilation"

    weight: Weight = 0.2
    depth: Positive = 0.02

    def __call__(self, rgba: Picture, severity: float, rng: np.random.Generator) -> Picture:
        """Spoil a picture; see `Perturbation`."""
        height, width = rgba.shape[:2]
        box = find_object(rgba)
        street = backdrop(rgba, box, rng)
        uneven = np.clip(1 + 0.6 * value_noise(height, width, 0.15 * box.extent, rng), 0, 3)
        _, alpha = colour_and_alpha(rgba)
        outwards = severity * self.depth * box.extent * uneven
        grown = np.clip(signed_distance(alpha) + outwards - 0.5, 0, 1)
        return reveal(rgba, np.maximum(alpha, grown), street)
