"""Defocus: every point becomes a disc."""

from __future__ import annotations

from typing import ClassVar

import numpy as np

from recast.recar.perturb.convolution import convolve
from recast.recar.perturb.extent import find_object
from recast.recar.perturb.kind import Kind, Picture, Positive, Weight
from recast.recar.perturb.premultiplied import Floats


def disc_kernel(radius: float) -> Floats:
    """Uniform disc (the circle of confusion) of a radius in pixels, edges in shares of pixels."""
    reach = int(np.ceil(radius))
    offset = np.arange(-reach, reach + 1, dtype=np.float32)
    distance = np.hypot(offset[:, None], offset[None, :])
    disc = np.clip(radius + 0.5 - distance, 0, 1)
    return (disc / disc.sum()).astype(np.float32)


class Defocus(Kind):
    """A lens out of focus, or with a drop of water on it.

    Attributes:
        radius: of the disc at severity 1, over the extent.
    """

    name: ClassVar[str] = "defocus"

    weight: Weight = 0.5
    radius: Positive = 0.025

    def __call__(self, rgba: Picture, severity: float, rng: np.random.Generator) -> Picture:
        """Spoil a picture; see `Perturbation`."""
        radius = severity * self.radius * find_object(rgba).extent
        return convolve(rgba, disc_kernel(radius), 1.5 * radius)
