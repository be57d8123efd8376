"""How large the object is in its picture, which is what all lengths are relative to."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from recast.recar.perturb.kind import Picture
from recast.trellis.conditioning.read import object_box


@dataclass(frozen=True)
class ObjectBox:
    """The object's box in its picture: where alpha exceeds 0.8.

    Attributes:
        left, top: first column and row, pixels.
        width, height: of the box, pixels.
    """

    left: int
    top: int
    width: int
    height: int

    @property
    def extent(self) -> int:
        """The longer side, pixels."""
        return max(self.width, self.height)

    @property
    def bottom(self) -> int:
        """The first row below the box."""
        return self.top + self.height

    @property
    def right(self) -> int:
        """The first column beyond the box."""
        return self.left + self.width


def find_object(rgba: Picture) -> ObjectBox:
    """The box of a picture that passes `recast.trellis.check_crop`."""
    left, top, right, bottom = object_box(rgba[..., 3])
    return ObjectBox(left, top, right - left + 1, bottom - top + 1)


def shrinking(extent: float, smallest: float, severity: float) -> float:
    """Scale factor in (0, 1] that brings an object to `smallest` pixels at severity 1.

    Geometric in between: equal steps of severity lose equal shares. An object that is smaller
    already keeps its size.
    """
    return float(np.minimum(1.0, smallest / extent) ** severity)
