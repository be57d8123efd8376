"""What stands in yards: shipping containers and pallets."""

from __future__ import annotations

import numpy as np

from recast.synthetic.scenery.arguments import require_count, require_size
from recast.synthetic.scenery.primitives import boxes
from recast.synthetic.surface import Surface


def container(rng: np.random.Generator, length: float = 6.06) -> Surface:
    """A shipping container, x in [-length/2, length/2], y in [0, 2.44], doors at +x.

    Args:
        rng: chooses the colour.
        length: metres, 2.5 to 16 (6.06 and 12.19 are the usual ones).

    Raises:
        InputError: for impossible lengths.
    """
    require_size("container", "length", length, 2.5, 16.0)
    half = length / 2
    paint = np.array([(0.30, 0.06, 0.03), (0.03, 0.10, 0.28), (0.05, 0.18, 0.10)][rng.integers(3)])
    return boxes((-half, 0, 0.0), (half, 2.44, 2.59), paint, "corrugated")


def pallets(rng: np.random.Generator, count: int | None = None) -> Surface:
    """A stack of pallets, some with goods, 1.2 m x 1.0 m about the origin.

    Args:
        rng: chooses goods and unevenness.
        count: pallets in the stack, 1 to 20; drawn when None.

    Raises:
        InputError: for impossible counts.
    """
    layers = (
        int(rng.integers(2, 9))
        if count is None
        else require_count("pallets", "count", count, 1, 20)
    )
    low = np.array([(-0.6, -0.5, 0.144 * k) for k in range(layers)])
    return boxes(low, low + [1.2, 1.0, 0.12], (0.35, 0.25, 0.15), "wood")
