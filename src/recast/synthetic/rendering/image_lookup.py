"""Bilinear look-up of many points in one image."""

from __future__ import annotations

import cv2
import numpy as np
from numpy.typing import NDArray

from recast.synthetic.rendering.embree import Float32Array


def gather_image(image: NDArray, x: Float32Array, y: Float32Array) -> NDArray:
    """Bilinear samples (at least N, channels) of an image at pixel coordinates x, y (N,).

    Pixel centres at whole numbers. The points are folded into a grid, as `cv2.remap` takes no side
    longer than 32767; the result is padded to full rows of that grid.
    """
    row = 1024
    count = len(x)
    height = -(-count // row)
    if not count:
        return np.zeros((0, image.shape[-1]), image.dtype)
    places = np.zeros((2, height * row), np.float32)
    places[0, :count], places[1, :count] = x, y
    columns, rows = places.reshape(2, height, row)
    samples = cv2.remap(image, columns, rows, cv2.INTER_LINEAR, borderMode=cv2.BORDER_REPLICATE)
    return samples.reshape(height * row, -1)
