"""Finishes and outlines that all vehicles share."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from numpy.typing import NDArray

from recast.synthetic.vehicles.solid import Finish, Solid

Array = NDArray[np.float64]

GLASS = Finish((0.018, 0.022, 0.022), "glass")
DARK_GLASS = Finish((0.008, 0.009, 0.01), "glass")
TRIM = Finish((0.018, 0.018, 0.019), "plastic")
CLADDING = Finish((0.045, 0.045, 0.047), "plastic")
UNDERSIDE = Finish((0.015, 0.015, 0.015), "matte")
SEAM = Finish((0.01, 0.01, 0.01), "matte")
CHROME = Finish((0.75, 0.76, 0.78), "chrome")
TYRE = Finish((0.02, 0.02, 0.021), "rubber")
ALLOY = Finish((0.45, 0.46, 0.47), "metal")
STEEL = Finish((0.12, 0.12, 0.125), "metal")
BEZEL = Finish((0.02, 0.02, 0.022), "plastic")
LAMP = Finish((0.3, 0.31, 0.33), "headlamp")
PROJECTOR = Finish((0.9, 0.92, 0.95), "chrome")
DAYLIGHT = Finish((0.85, 0.87, 0.9), "headlamp")
INDICATOR = Finish((0.75, 0.25, 0.02), "taillamp")
TAIL = Finish((0.42, 0.008, 0.01), "taillamp")
REVERSE = Finish((0.6, 0.58, 0.58), "taillamp")
PLATE = Finish((0.72, 0.72, 0.7), "plate")
REAR_PLATE = Finish((0.72, 0.68, 0.5), "plate")
DISPLAY = Finish((0.9, 0.42, 0.05), "signal")
INK = Finish((0.015, 0.015, 0.02), "plate")


Area = tuple[list[Array], list[Array]]
"""Borders and limits, see `Solid.paint`."""


def smooth_max(fields: Sequence[Array], radius: float) -> Array:
    """The greatest of the fields, with corners rounded at about `radius` metres."""
    best = fields[0]
    for field in fields[1:]:
        blend = np.maximum(radius - np.abs(best - field), 0)
        best = np.maximum(best, field) + blend**2 / (4 * radius)
    return best


def strip(distance: Array, half: float) -> list[Array]:
    """Fields of what lies within `half` metres of the zero of `distance`."""
    return [distance - half, -distance - half]


def rectangle(
    u: Array, v: Array, centre: tuple[float, float], size: tuple[float, float]
) -> list[Array]:
    """Fields of an upright rectangle."""
    return [*strip(u - centre[0], size[0] / 2), *strip(v - centre[1], size[1] / 2)]


def xyz(solid: Solid) -> tuple[Array, Array, Array]:
    """The coordinates of a solid's points, one array each."""
    return solid.points[:, 0], solid.points[:, 1], solid.points[:, 2]
