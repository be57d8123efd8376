"""Distance of pixels to the edge of a mask."""

from __future__ import annotations

import cv2
import numpy as np

from recast.recar.perturb.premultiplied import Floats


def signed_distance(alpha: Floats) -> Floats:
    """Pixels to the nearest pixel across the edge, less a half: positive where alpha > 0.5.

    Args:
        alpha: (H, W) float32 in [0, 1].

    Returns:
        (H, W) float32: 0.5 in the first pixel inside, -0.5 in the first one outside.
    """
    inside = (alpha > 0.5).astype(np.uint8)
    within = cv2.distanceTransform(inside, cv2.DIST_L2, cv2.DIST_MASK_PRECISE)
    beyond = cv2.distanceTransform(1 - inside, cv2.DIST_L2, cv2.DIST_MASK_PRECISE)
    return np.where(inside > 0, within - 0.5, 0.5 - beyond).astype(np.float32)
