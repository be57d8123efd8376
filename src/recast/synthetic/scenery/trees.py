"""Trees."""

from __future__ import annotations

import numpy as np

from recast.synthetic.scenery.arguments import require_known, require_size
from recast.synthetic.scenery.primitives import lathe
from recast.synthetic.surface import Surface, concatenate

TREE_STYLES = ("round", "conifer", "tall")


def tree(
    rng: np.random.Generator, height: float, style: str = "round", detail: float = 1.0
) -> Surface:
    """A tree whose trunk stands at the origin.

    Args:
        rng: chooses the shape and the greens.
        height: metres, 1.5 to 30.
        style: "round" (broad-leaved), "conifer" or "tall" (poplar).
        detail: share of the triangles to spend, 0.2 to 1.

    Raises:
        InputError: for impossible sizes and unknown styles.
    """
    require_size("tree", "height", height, 1.5, 30.0)
    require_size("tree", "detail", detail, 0.2, 1.0)
    require_known("tree", "style", style, TREE_STYLES)
    trunk = lathe(
        [(0.03 * height, -0.2), (0.02 * height, 0.5 * height)], 8, (0.13, 0.1, 0.07), "bark"
    )
    crown = lathe(
        [
            (0.0, 0.25 * height),
            (0.25 * height, 0.5 * height),
            (0.2 * height, 0.8 * height),
            (0.0, height),
        ],
        10,
        np.array((0.06, 0.12, 0.03)) * rng.uniform(0.8, 1.2),
        "foliage",
    )
    return concatenate([trunk, crown])
