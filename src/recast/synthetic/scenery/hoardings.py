"""Advertising boards."""

from __future__ import annotations

import numpy as np

from recast.synthetic.scenery.arguments import require_size
from recast.synthetic.scenery.primitives import boxes
from recast.synthetic.surface import Surface, concatenate


def hoarding(rng: np.random.Generator, width: float = 6.0, height: float = 3.0) -> Surface:
    """An advertising board on legs, facing -y, centred at x = 0; its lower edge 2.2 to 3 m up.

    Args:
        rng: chooses the poster.
        width, height: metres of the board, 1 to 20 and 0.8 to 10.

    Raises:
        InputError: for impossible sizes.
    """
    require_size("hoarding", "width", width, 1.0, 20.0)
    require_size("hoarding", "height", height, 0.8, 10.0)
    low = rng.uniform(2.2, 3.0)
    half, top = width / 2, low + height
    frame = (0.06, 0.065, 0.07)
    hue = rng.uniform(0.05, 0.6, (3, 3))
    parts = [
        boxes((-half, -0.12, low), (half, 0.12, top), frame, "plastic"),
        boxes((-half + 0.1, -0.13, low + 0.1), (half - 0.1, -0.12, top - 0.1), hue[0], "plastic"),
    ]
    return concatenate(parts)
