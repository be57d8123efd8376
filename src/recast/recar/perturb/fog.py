"""Fog: Koschmieder's law."""

from __future__ import annotations

from typing import ClassVar

import numpy as np

from recast.recar.perturb.kind import Kind, Picture, Positive, Positives, Shares
from recast.recar.perturb.linear_light import to_display, to_linear
from recast.recar.perturb.premultiplied import Floats, colour_and_alpha, with_alpha

CONTRAST = 3.912
"""-ln 0.02: visibility is where two hundredths of the contrast are left (Koschmieder, 1924)."""


def koschmieder(light: Floats, transmission: float, airlight: Floats) -> Floats:
    """I = J t + A (1 - t) in linear light, t = exp(-beta d), one depth for the whole object.

    Args:
        light: (H, W, 3) J without fog.
        transmission: t in [0, 1].
        airlight: (3,) A.
    """
    return light * np.float32(transmission) + airlight * np.float32(1 - transmission)


class Fog(Kind):
    """Fog or haze, and the veil of a dirty windscreen.

    Attributes:
        visibility_m: at severity 1; the density beta = 3.912 / visibility grows with severity.
        distance_m: nearest and farthest vehicle, drawn uniformly.
        airlight: darkest and lightest grey of the fog, sRGB.
    """

    name: ClassVar[str] = "fog"

    visibility_m: Positive = 150.0
    distance_m: Positives = (10.0, 40.0)
    airlight: Shares = (0.55, 0.9)

    def __call__(self, rgba: Picture, severity: float, rng: np.random.Generator) -> Picture:
        """Spoil a picture; see `Perturbation`."""
        distance = rng.uniform(*self.distance_m)
        grey = rng.uniform(*self.airlight) * rng.uniform(0.96, 1.04, 3)
        transmission = float(np.exp(-severity * CONTRAST / self.visibility_m * distance))
        colour, alpha = colour_and_alpha(rgba)
        airlight = to_linear(np.clip(grey, 0, 1).astype(np.float32))
        fogged = koschmieder(to_linear(colour), transmission, airlight)
        return with_alpha(to_display(fogged), alpha)
