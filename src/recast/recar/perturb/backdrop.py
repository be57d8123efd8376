"""A made-up street behind an object, for faults that let some of the background in."""

from __future__ import annotations

import numpy as np

from recast.recar.perturb.extent import ObjectBox
from recast.recar.perturb.kind import Picture
from recast.recar.perturb.premultiplied import Floats
from recast.recar.perturb.value_noise import value_noise
from recast.trellis.conditioning.read import OPAQUE

_BEHIND = np.array(
    [
        (0.62, 0.55, 0.46),  # plaster
        (0.42, 0.30, 0.25),  # brick
        (0.52, 0.52, 0.52),  # concrete
        (0.18, 0.23, 0.13),  # hedge
        (0.12, 0.15, 0.11),  # trees in the shade
        (0.66, 0.74, 0.84),  # sky
        (0.28, 0.28, 0.31),  # another vehicle, a dark window
    ],
    np.float32,
)


_DAYLIGHT = 0.6  # the brightest parts of a dark car by day, in display colours


def backdrop(rgba: Picture, box: ObjectBox, rng: np.random.Generator) -> Floats:
    """A road, and what stands beyond it, in the light in which the object is seen.

    The horizon runs through the upper part of the object, as a car's camera sees other cars.

    Args:
        rgba: (H, W, 4) uint8 of the object; where even its brightest parts are dark, it is dark.
        box: of the object.
        rng: of everything random.

    Returns:
        (H, W, 3) float32 display colours in [0, 1].
    """
    height, width = rgba.shape[:2]
    extent = box.extent
    rows = np.arange(height, dtype=np.float32)[:, None]
    columns = np.arange(width, dtype=np.float32)[None, :]
    fine = value_noise(height, width, 0.06 * extent, rng)
    coarse = value_noise(height, width, 0.3 * extent, rng)

    grey = rng.uniform(0.22, 0.5) * np.array([1.0, 0.99, rng.uniform(0.92, 1.05)], np.float32)
    road = grey * (1 + 0.05 * fine + 0.08 * coarse)[..., None]

    standing = np.sort(rng.uniform(box.left - extent / 2, box.right + extent / 2, 4))
    colours = _BEHIND[rng.integers(len(_BEHIND), size=5)] * rng.uniform(0.6, 1.25, (5, 1))
    beyond = colours.astype(np.float32)[np.searchsorted(standing, columns[0])][None]
    beyond = beyond * (1 + 0.12 * fine + 0.12 * coarse)[..., None]

    horizon = box.top + rng.uniform(0.0, 0.55) * box.height + 0.02 * extent * coarse
    brightest = float(np.quantile(rgba[rgba[..., 3] > OPAQUE][:, :3], 0.97)) / 255
    light = rng.uniform(0.7, 1.15) * min(1.0, brightest / _DAYLIGHT)
    street = np.where((rows > horizon)[..., None], road, beyond) * light
    return np.clip(street, 0, 1).astype(np.float32)
