"""Cropping: the vehicle leaves the camera's picture."""

from __future__ import annotations

from typing import ClassVar

import numpy as np

from recast.recar.perturb.extent import find_object
from recast.recar.perturb.kind import Kind, Picture, Share

_SIDES = ("left", "right", "bottom", "top")
_CHANCES = (0.4, 0.4, 0.15, 0.05)


class Cropping(Kind):
    """A straight cut by the picture's border: left or right, less often below or above.

    The picture keeps its size; what is cut off becomes transparent, and `crop_to_object` then
    centres what is left, as it does with a vehicle at the border of a log's picture.

    Attributes:
        cut: share of the object's width or height that is lost at severity 1.
    """

    name: ClassVar[str] = "cropping"

    cut: Share = 0.5

    def __call__(self, rgba: Picture, severity: float, rng: np.random.Generator) -> Picture:
        """Spoil a picture; see `Perturbation`."""
        box = find_object(rgba)
        side = _SIDES[int(rng.choice(len(_SIDES), p=_CHANCES))]
        across = side in ("left", "right")
        lost = round(severity * self.cut * (box.width if across else box.height))
        out = rgba.copy()
        if lost == 0:
            return out
        if side == "left":
            out[:, : box.left + lost] = 0
        elif side == "right":
            out[:, box.right - lost :] = 0
        elif side == "bottom":
            out[box.bottom - lost :] = 0
        else:
            out[: box.top + lost] = 0
        return out
