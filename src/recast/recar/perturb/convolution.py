"""Optical blur of a cut-out object by any kernel."""

from __future__ import annotations

import cv2
import numpy as np

from recast.recar.perturb.kind import Picture
from recast.recar.perturb.linear_light import to_display, to_linear
from recast.recar.perturb.premultiplied import Floats, colour_and_alpha, with_alpha
from recast.recar.perturb.segmented import segmented


def convolve(rgba: Picture, kernel: Floats, width: float) -> Picture:
    """Blur in linear light, premultiplied by alpha; the mask is then cut as a segmenter would.

    Args:
        rgba: (H, W, 4) uint8, straight alpha.
        kernel: (k, k) that sums to 1, k odd.
        width: of an edge after the blur, pixels.
    """
    colour, alpha = colour_and_alpha(rgba)
    light = np.dstack([to_linear(colour) * alpha[..., None], alpha])
    # Nothing is known beyond the picture: the object goes on there as at its border.
    blurred = cv2.filter2D(light, cv2.CV_32F, kernel, borderType=cv2.BORDER_REPLICATE)
    seen = np.clip(np.asarray(blurred[..., 3], np.float32), 0, 1)
    display = to_display(blurred[..., :3] / np.maximum(seen, 1e-6)[..., None])
    return with_alpha(display, segmented(seen, width))
