"""From linear radiance to an sRGB image."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from recast.synthetic.rendering.embree import Float32Array

WHITE_LEVEL = 0.78
"""What a white level surface in the open becomes before the tone curve, at exposure 1."""
CLIP = 4.0
"""Radiance, in units of a white surface, at which a pixel's samples saturate before averaging."""

SATURATION = np.float32(1.12)
"""Cameras render colours a little stronger than they are."""
LUMINANCE = np.array([0.2126, 0.7152, 0.0722], np.float32)
"""Of linear RGB, ITU-R BT.709."""
_TABLE_SIZE = 4096


def filmic(linear: Float32Array) -> Float32Array:
    """Film-like curve from scene-linear to display-linear [0, 1]: toe, straight part, shoulder.

    The rational form of K. Narkowicz, "ACES filmic tone mapping curve" (2015), with its toe raised
    from 0.03 to 0.12: cameras on cars keep shadows readable.
    """
    curve = linear * (2.51 * linear + 0.12) / (linear * (2.43 * linear + 0.59) + 0.14)
    return np.clip(curve, 0, 1)


def srgb(linear: Float32Array) -> Float32Array:
    """IEC 61966-2-1 encoding of display-linear [0, 1]."""
    return np.where(linear <= 0.0031308, 12.92 * linear, 1.055 * linear ** (1 / 2.4) - 0.055)


def _table() -> NDArray[np.float32]:
    level = (np.linspace(0, 1, _TABLE_SIZE) ** 2 * 16).astype(np.float32)
    return (srgb(filmic(level)) * 255).astype(np.float32)


_CURVE = _table()


def develop(radiance: Float32Array, white: float, exposure: float) -> NDArray[np.uint8]:
    """Image (..., 3) uint8 of linear radiance (..., 3).

    Args:
        white: radiance of a white level surface in the open.
        exposure: factor on the light; 1 is right for the day.
    """
    scale = np.float32(exposure * WHITE_LEVEL / white / 16)
    grey = radiance @ LUMINANCE
    vivid = radiance * SATURATION + ((1 - SATURATION) * grey)[..., None]
    position = np.sqrt(np.clip(vivid * scale, 0, 1)) * np.float32(_TABLE_SIZE - 1)
    below = np.minimum(position.astype(np.int32), _TABLE_SIZE - 2)
    value = np.take(_CURVE, below)
    value += (np.take(_CURVE, below + 1) - value) * (position - below)
    return (value + np.float32(0.5)).astype(np.uint8)
