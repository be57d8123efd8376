"""A mask with holes: windows and dark parts taken for background."""

from __future__ import annotations

from typing import ClassVar

import cv2
import numpy as np

from recast.recar.perturb.extent import find_object
from recast.recar.perturb.kind import Kind, Picture, Share, Weight
from recast.recar.perturb.linear_light import to_linear
from recast.recar.perturb.premultiplied import colour_and_alpha, with_alpha
from recast.recar.perturb.value_noise import value_noise

_LUMINANCE = np.array([0.2126, 0.7152, 0.0722], np.float32)  # ITU-R BT.709


class Holes(Kind):
    """Lumps that are missing, the dark parts (glass, tyres, arches) before the others.

    Attributes:
        share: of the object's area at severity 1.
        darkness: weight of a pixel's darkness against that of chance.
    """

    name: ClassVar[str] = "holes"

    weight: Weight = 0.2
    share: Share = 0.22
    darkness: Share = 0.4

    def __call__(self, rgba: Picture, severity: float, rng: np.random.Generator) -> Picture:
        """Spoil a picture; see `Perturbation`."""
        height, width = rgba.shape[:2]
        extent = find_object(rgba).extent
        lumps = value_noise(height, width, rng.uniform(0.12, 0.3) * extent, rng, octaves=2)
        colour, alpha = colour_and_alpha(rgba)
        inside = alpha > 0.5
        bright = to_linear(colour) @ _LUMINANCE
        order = np.searchsorted(np.sort(bright[inside]), bright) / max(int(inside.sum()), 1)
        # Smooth, or single dark pixels would make a sieve of it.
        rank = cv2.GaussianBlur(order.astype(np.float32), (0, 0), 0.02 * extent)
        field = (1 - self.darkness) * lumps + self.darkness * 3 * (rank - 0.5)
        lowest = np.quantile(field[inside], severity * self.share)
        # A ramp of about a pixel: lumps rise by one over a tenth of the extent.
        kept = np.clip((field - lowest) * 0.1 * extent + 1 - severity, 0, 1)
        return with_alpha(colour, (alpha * kept).astype(np.float32))
