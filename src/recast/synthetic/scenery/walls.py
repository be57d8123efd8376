"""Wall colours, and putting drawn facades on the four sides of a building."""

from __future__ import annotations

import numpy as np

from recast.synthetic.scenery.openings import Colour
from recast.synthetic.scenery.panels import Panels
from recast.synthetic.scenery.primitives import at
from recast.synthetic.surface import Surface

BRICKS = np.array(
    [
        (0.31, 0.12, 0.075),
        (0.40, 0.20, 0.12),
        (0.24, 0.115, 0.085),
        (0.48, 0.37, 0.25),
        (0.36, 0.155, 0.09),
    ]
)
PLASTERS = np.array(
    [
        (0.60, 0.55, 0.45),
        (0.56, 0.46, 0.30),
        (0.64, 0.62, 0.58),
        (0.50, 0.34, 0.26),
        (0.42, 0.46, 0.43),
        (0.58, 0.42, 0.33),
        (0.38, 0.43, 0.49),
        (0.66, 0.60, 0.44),
        (0.46, 0.44, 0.42),
    ]
)
BOARDS = np.array([(0.62, 0.62, 0.60), (0.30, 0.37, 0.44), (0.58, 0.51, 0.33), (0.33, 0.38, 0.31)])
FRAMES = np.array(
    [
        (0.68, 0.68, 0.66),
        (0.68, 0.68, 0.66),
        (0.05, 0.05, 0.055),
        (0.16, 0.09, 0.05),
        (0.10, 0.14, 0.13),
    ]
)
DOORS = np.array(
    [
        (0.20, 0.02, 0.02),
        (0.02, 0.06, 0.12),
        (0.03, 0.09, 0.05),
        (0.10, 0.055, 0.03),
        (0.02, 0.02, 0.022),
        (0.40, 0.27, 0.05),
    ]
)


def pick(rng: np.random.Generator, palette: np.ndarray, spread: float = 0.12) -> Colour:
    """One colour of a palette, a little lighter or darker."""
    r, g, b = palette[rng.integers(len(palette))] * rng.uniform(1 - spread, 1 + spread)
    return float(r), float(g), float(b)


def scaled(colour: Colour, factor: float) -> Colour:
    """Lighter or darker."""
    r, g, b = (min(0.9, factor * channel) for channel in colour)
    return r, g, b


def around(
    width: float, depth: float, front: Panels, right: Panels, back: Panels, left: Panels
) -> list[Surface]:
    """The facades, each drawn as if it were the front, on their sides of the building."""
    return [
        at(front.surface(), -width / 2, 0.0),
        at(right.surface(), width / 2, 0.0, 0.0, np.pi / 2),
        at(back.surface(), width / 2, depth, 0.0, np.pi),
        at(left.surface(), -width / 2, depth, 0.0, -np.pi / 2),
    ]
