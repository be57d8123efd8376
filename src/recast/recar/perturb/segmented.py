"""The mask that a segmenter draws around an object without sharp edges."""

from __future__ import annotations

import numpy as np

from recast.recar.perturb.premultiplied import Floats


def segmented(alpha: Floats, width: float) -> Floats:
    """Sharpen a blurred coverage about one half, as segmenters cut sharply through any blur.

    Args:
        alpha: (H, W) in [0, 1], blurred.
        width: of the blurred edge, pixels; up to 1 the mask stays as it is.

    Returns:
        (H, W) in [0, 1] with edges about a pixel wide.
    """
    return np.clip((alpha - 0.5) * max(width, 1.0) + 0.5, 0, 1)
