"""Straight and premultiplied alpha.

Colour beside an object's edge means nothing where alpha is zero, so whatever mixes neighbouring
pixels works on colour times alpha.
"""

from __future__ import annotations

from typing import Any

import numpy as np
from numpy.typing import NDArray

from recast.recar.perturb.kind import Picture

Floats = NDArray[np.floating[Any]]


def premultiplied(rgba: Picture) -> Floats:
    """(H, W, 4) float32 in [0, 1]: colour times alpha, and alpha."""
    unit = np.asarray(rgba, np.float32) / 255
    unit[..., :3] *= unit[..., 3:]
    return unit


def straight(mixed: Floats) -> Picture:
    """(H, W, 4) uint8 with straight alpha of premultiplied values; black where alpha is zero."""
    alpha = np.clip(mixed[..., 3], 0, 1)
    return with_alpha(mixed[..., :3] / np.maximum(alpha, 1e-6)[..., None], alpha)


def with_alpha(colour: Floats, alpha: Floats) -> Picture:
    """(H, W, 4) uint8 of straight colours (H, W, 3) and alpha (H, W), both in [0, 1]."""
    levels = np.round(255 * np.clip(alpha, 0, 1)).astype(np.uint8)
    rgb = np.round(255 * np.clip(colour, 0, 1)).astype(np.uint8)
    rgb[levels == 0] = 0
    return np.dstack([rgb, levels])


def colour_and_alpha(rgba: Picture) -> tuple[Floats, Floats]:
    """Straight colours (H, W, 3), black where alpha is zero, and alpha (H, W); in [0, 1]."""
    unit = np.asarray(rgba, np.float32) / 255
    unit[rgba[..., 3] == 0] = 0
    return unit[..., :3], unit[..., 3]
