"""Between display colours (sRGB) and linear light, where exposure and fog act."""

from __future__ import annotations

import numpy as np

from recast.recar.perturb.premultiplied import Floats


def to_linear(display: Floats) -> Floats:
    """Linear light in [0, 1] of sRGB in [0, 1] (IEC 61966-2-1)."""
    return np.where(display <= 0.04045, display / 12.92, ((display + 0.055) / 1.055) ** 2.4)


def to_display(linear: Floats) -> Floats:
    """Linear light as sRGB in [0, 1]; light beyond 1 is clipped as by a sensor."""
    light = np.clip(linear, 0, 1)
    return np.where(light <= 0.0031308, 12.92 * light, 1.055 * light ** (1 / 2.4) - 0.055)
