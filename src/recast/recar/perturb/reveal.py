"""A mask that grows: what lies behind the object comes into the picture."""

from __future__ import annotations

import numpy as np

from recast.recar.perturb.kind import Picture
from recast.recar.perturb.premultiplied import Floats, colour_and_alpha, with_alpha


def reveal(rgba: Picture, alpha: Floats, behind: Floats) -> Picture:
    """Give a picture another mask; where that is larger, the background is seen through it.

    Args:
        rgba: (H, W, 4) uint8, straight alpha.
        alpha: (H, W) in [0, 1], the new mask.
        behind: (H, W, 3) in [0, 1], display colours.

    Returns:
        (H, W, 4) uint8, straight alpha.
    """
    colour, before = colour_and_alpha(rgba)
    added = np.maximum(alpha - before, 0) / np.maximum(alpha, 1e-6)
    return with_alpha(colour + (behind - colour) * added[..., None], alpha)
