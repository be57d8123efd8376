"""A car made of a few shapes, to perturb."""

from __future__ import annotations

import cv2
import numpy as np
from numpy.typing import NDArray

Image = NDArray[np.uint8]


def drawn_car(extent: int = 160, *, edge: float = 0.35) -> Image:
    """A textured car from the side, (H, W, 4) uint8, antialiased, `extent` pixels long."""
    four = 4 * extent
    margin = int(edge * four)
    height, width = int(0.42 * four) + 2 * margin, four + 2 * margin
    colour = np.full((height, width, 3), (150, 60, 50), np.uint8)
    alpha = np.zeros((height, width), np.uint8)
    bottom = height - margin

    def box(left: float, top: float, right: float, low: float) -> tuple[slice, slice]:
        return (
            slice(bottom - int(top * four), bottom - int(low * four)),
            slice(margin + int(left * four), margin + int(right * four)),
        )

    alpha[box(0, 0.26, 1, 0.07)] = 255
    alpha[box(0.2, 0.42, 0.8, 0.2)] = 255
    colour[box(0.24, 0.39, 0.48, 0.27)] = (40, 46, 52)
    colour[box(0.52, 0.39, 0.76, 0.27)] = (40, 46, 52)
    colour[box(0, 0.24, 0.06, 0.18)] = (240, 235, 210)
    for place in np.linspace(0.1, 0.9, 9):
        colour[box(place, 0.26, place + 0.006, 0.1)] = (90, 30, 25)
    for place in (0.2, 0.8):
        centre = (margin + int(place * four), bottom - int(0.09 * four))
        cv2.circle(alpha, centre, int(0.09 * four), 255, -1)
        cv2.circle(colour, centre, int(0.09 * four), (25, 25, 25), -1)
        cv2.circle(colour, centre, int(0.05 * four), (170, 170, 175), -1)
    size = (width // 4, height // 4)
    small = cv2.resize(alpha, size, interpolation=cv2.INTER_AREA)
    rgb = cv2.resize(colour, size, interpolation=cv2.INTER_AREA)
    return np.dstack([np.where(small[..., None] > 0, rgb, 0), small]).astype(np.uint8)


def difference(one: Image, other: Image) -> float:
    """Mean absolute difference of premultiplied colours and alpha, in 8-bit levels."""
    mixed = [np.asarray(a, np.float64) for a in (one, other)]
    for a in mixed:
        a[..., :3] *= a[..., 3:] / 255
    return float(np.abs(mixed[0] - mixed[1]).mean())
