"""Bushes and hedges."""

from __future__ import annotations

import numpy as np

from recast.synthetic.scenery.arguments import require_size
from recast.synthetic.scenery.primitives import boxes, lathe
from recast.synthetic.surface import Surface


def bush(rng: np.random.Generator, height: float = 1.0) -> Surface:
    """A bush at the origin, about as wide as tall.

    Args:
        rng: chooses the shape and the greens.
        height: metres, 0.2 to 4.

    Raises:
        InputError: for impossible heights.
    """
    require_size("bush", "height", height, 0.2, 4.0)
    return lathe(
        [(0.3 * height, 0.0), (0.5 * height, 0.5 * height), (0.0, height)],
        10,
        np.array((0.06, 0.12, 0.03)) * rng.uniform(0.8, 1.2),
        "foliage",
    )


def hedge(
    rng: np.random.Generator, length: float, height: float = 1.4, width: float = 0.8
) -> Surface:
    """A clipped hedge from x = 0 to x = length, centred on y = 0.

    Args:
        rng: chooses unevenness and greens.
        length, height, width: metres, 0.5 to 500, 0.3 to 4 and 0.2 to 3.

    Raises:
        InputError: for impossible sizes.
    """
    require_size("hedge", "length", length, 0.5, 500.0)
    require_size("hedge", "height", height, 0.3, 4.0)
    require_size("hedge", "width", width, 0.2, 3.0)
    return boxes(
        (0, -width / 2, 0),
        (length, width / 2, height),
        np.array((0.05, 0.1, 0.025)) * rng.uniform(0.8, 1.2),
        "foliage",
        bottom=False,
    )
