"""Smooth random fields: value noise over a few octaves."""

from __future__ import annotations

import cv2
import numpy as np

from recast.recar.perturb.premultiplied import Floats


def value_noise(
    height: int, width: int, cell: float, rng: np.random.Generator, octaves: int = 3
) -> Floats:
    """Random field (height, width) float32 with mean about 0 and standard deviation about 1.

    Args:
        height, width: pixels.
        cell: size of its largest lumps, pixels.
        rng: of the lumps.
        octaves: each has lumps of half the size and of 0.5 times the strength.
    """
    total, power = np.zeros((height, width), np.float32), 0.0
    for octave in range(octaves):
        size = max(cell / 2**octave, 1.0)
        rows, columns = int(height / size) + 2, int(width / size) + 2
        grid = rng.standard_normal((rows, columns), np.float32)
        # Two knots beyond the field at most, so lumps keep their size at its borders.
        large = cv2.resize(grid, (round(columns * size) + 1, round(rows * size) + 1),
                           interpolation=cv2.INTER_CUBIC)  # fmt: skip
        total += 0.5**octave * large[:height, :width]
        power += 0.25**octave
    return total / np.float32(0.75 * np.sqrt(power))
