"""What an occluder does to a cut-out object: it takes it away, or stays as a fringe."""

from __future__ import annotations

import cv2
import numpy as np

from recast.recar.perturb.kind import Picture
from recast.recar.perturb.premultiplied import Floats, colour_and_alpha, with_alpha


def occlude(rgba: Picture, coverage: Floats, colour: Floats, fringe: float) -> Picture:
    """Put an occluder before the object, which the segmenter leaves out but for a fringe.

    An occluder narrower than two fringes stays in the mask whole, as thin poles do.

    Args:
        rgba: (H, W, 4) uint8, straight alpha.
        coverage: (H, W) in [0, 1] of the occluder.
        colour: (3,) of the occluder, sRGB in [0, 1].
        fringe: width of the occluder's edge that is taken for the object, pixels.

    Returns:
        (H, W, 4) uint8, straight alpha.
    """
    before, alpha = colour_and_alpha(rgba)
    solid = (coverage > 0.5).astype(np.uint8)
    depth = cv2.distanceTransform(solid, cv2.DIST_L2, cv2.DIST_MASK_PRECISE)
    removed = coverage * np.clip(depth - fringe + 0.5, 0, 1)
    # Antialiased pixels just outside the solid part are removed with it, or stay with its fringe.
    if fringe < 0.5:
        removed = np.where(solid > 0, removed, coverage)
    seen = before + (colour - before) * coverage[..., None]
    return with_alpha(seen, alpha * (1 - removed))
