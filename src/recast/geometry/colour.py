"""Between display colours in [0, 1] and linear light, where light adds up: sRGB and a power law."""

from __future__ import annotations

from typing import Any

import cv2
import numpy as np
from numpy.typing import NDArray

Floats = NDArray[np.floating[Any]]

LUMINANCE = (0.2126, 0.7152, 0.0722)
"""Weights of linear red, green and blue (ITU-R BT.709)."""
GAMMA = 2.2
"""The power law between display values and linear light, near enough to sRGB."""


def srgb_to_linear(display: Floats) -> NDArray[Any]:
    """Linear light of sRGB in [0, 1] (IEC 61966-2-1)."""
    return np.where(display <= 0.04045, display / 12.92, ((display + 0.055) / 1.055) ** 2.4)


def linear_to_srgb(linear: Floats) -> NDArray[Any]:
    """Linear light as sRGB in [0, 1] (IEC 61966-2-1); light beyond 1 is clipped as by a sensor."""
    light = np.clip(linear, 0, 1)
    return np.where(light <= 0.0031308, 12.92 * light, 1.055 * light ** (1 / 2.4) - 0.055)


def cielab(display: Floats) -> NDArray[np.float64]:
    """CIE Lab (..., 3) of sRGB (..., 3) in [0, 1], D65; single precision."""
    flat = np.asarray(display, np.float32).reshape(1, -1, 3)
    return np.asarray(cv2.cvtColor(flat, cv2.COLOR_RGB2LAB), np.float64).reshape(display.shape)


def gamma_to_linear(display: Floats) -> NDArray[Any]:
    """Linear light of display values, by the power law; clipped to [0, 1]."""
    return np.clip(display, 0, 1) ** GAMMA


def linear_to_gamma(linear: Floats) -> NDArray[Any]:
    """Display values of linear light, by the power law; clipped to [0, 1]."""
    return np.clip(linear, 0, 1) ** (1 / GAMMA)
