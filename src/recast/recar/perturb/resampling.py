"""Down-up sampling: a far vehicle covers few pixels."""

from __future__ import annotations

from typing import ClassVar

import cv2
import numpy as np

from recast.recar.perturb.extent import find_object, shrinking
from recast.recar.perturb.kind import Kind, Picture, Positive
from recast.recar.perturb.premultiplied import premultiplied, straight

_ENLARGERS = (cv2.INTER_LINEAR, cv2.INTER_CUBIC, cv2.INTER_LANCZOS4)


def resample(rgba: Picture, scale: float, enlarger: int) -> Picture:
    """Shrink by a factor in (0, 1] through area averages, and enlarge again.

    Args:
        rgba: (H, W, 4) uint8, straight alpha.
        scale: of the small picture over this one.
        enlarger: OpenCV's interpolation on the way up.
    """
    height, width = rgba.shape[:2]
    small_size = (max(round(width * scale), 1), max(round(height * scale), 1))
    if small_size == (width, height):
        return rgba.copy()
    small = cv2.resize(premultiplied(rgba), small_size, interpolation=cv2.INTER_AREA)
    large = cv2.resize(small, (width, height), interpolation=enlarger)
    return straight(np.clip(large, 0, 1))


class Resampling(Kind):
    """Detail lost to few pixels, then enlarged by a drawn filter (linear, cubic or Lanczos).

    Attributes:
        smallest: extent in pixels at severity 1; the extent falls geometrically down to it.
    """

    name: ClassVar[str] = "resampling"

    smallest: Positive = 32.0

    def __call__(self, rgba: Picture, severity: float, rng: np.random.Generator) -> Picture:
        """Spoil a picture; see `Perturbation`."""
        enlarger = _ENLARGERS[int(rng.integers(len(_ENLARGERS)))]
        scale = shrinking(find_object(rgba).extent, self.smallest, severity)
        return resample(rgba, scale, enlarger)
