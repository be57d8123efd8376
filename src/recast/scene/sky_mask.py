"""Which pixels show the sky, without a network: no LiDAR, joined to the top, bright and smooth."""

from __future__ import annotations

import cv2
import numpy as np
from numpy.typing import NDArray

Mask = NDArray[np.bool_]


def sky_mask(
    image: NDArray[np.uint8],
    occupied: Mask,
    *,
    brightness: float = 0.62,
    gradient: float = 0.12,
    margin: int = 1,
) -> Mask:
    """Guess the sky of one image.

    A pixel is taken for sky where it is bright or clearly blue, its surroundings are smooth, no
    LiDAR point is near, and a chain of such pixels leads to the top edge. Errs on the small side:
    the sky loss only needs pixels that are surely sky.

    Args:
        image: (H, W, 3) RGB.
        occupied: (H, W) pixels on or near a LiDAR return, hence not sky.
        brightness: least value of the brightest channel.
        gradient: largest step of the grey value across neighbouring pixels.
        margin: pixels cut from the border of the region found.

    Returns:
        (H, W) bool.
    """
    rgb = image.astype(np.float32) / 255
    brightest = rgb.max(-1)
    blue = rgb[..., 2] - rgb[..., 0]
    grey = rgb @ np.array([0.299, 0.587, 0.114], np.float32)
    dx = cv2.Sobel(grey, cv2.CV_32F, 1, 0, ksize=3, scale=0.25)
    dy = cv2.Sobel(grey, cv2.CV_32F, 0, 1, ksize=3, scale=0.25)
    smooth = np.hypot(dx, dy) < gradient
    # Foliage and walls lit by the sun are bright too, but warm: red above blue.
    candidate = (brightest > brightness) & (blue > -0.02) & smooth & ~occupied
    # Thin bright strips (frames of signs, lamps) touch the top edge too; the sky is wide.
    square = np.ones((5, 5), np.uint8)
    opened = cv2.dilate(cv2.erode(candidate.astype(np.uint8), square, borderValue=1), square)
    wide = candidate & (opened > 0)
    _, labels = cv2.connectedComponents(wide.astype(np.uint8), connectivity=4)
    from_top = np.unique(labels[0])
    mask = np.isin(labels, from_top[from_top > 0])
    if margin:
        kernel = np.ones((2 * margin + 1, 2 * margin + 1), np.uint8)
        mask = cv2.erode(mask.astype(np.uint8), kernel, borderValue=1).astype(bool)
    return mask
