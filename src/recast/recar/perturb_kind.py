"""What all kinds of perturbation share: the seam, the object's box, alpha, light, masks and noise.

Colour beside an object's edge means nothing where alpha is zero, so whatever mixes neighbouring
pixels works on colour times alpha.
"""

from __future__ import annotations

from abc import ABC, abstractmethod
from dataclasses import dataclass
from typing import Annotated, Any, ClassVar

import cv2
import numpy as np
from numpy.typing import NDArray
from pydantic import AfterValidator, Field

from recast.arrays import Image
from recast.core.records import Record
from recast.trellis.conditioning import OPAQUE, object_box

Floats = NDArray[np.floating[Any]]


def _in_order(interval: tuple[float, float]) -> tuple[float, float]:
    if interval[0] > interval[1]:
        raise ValueError(f"the first value {interval[0]:g} is above the second {interval[1]:g}")
    return interval


Share = Annotated[float, Field(ge=0, le=1)]
Positive = Annotated[float, Field(gt=0, allow_inf_nan=False)]
Weight = Annotated[float, Field(ge=0, allow_inf_nan=False)]
Shares = Annotated[tuple[Share, Share], AfterValidator(_in_order)]
Positives = Annotated[tuple[Positive, Positive], AfterValidator(_in_order)]


class PerturbationKind(Record, ABC):
    """One kind with its figures, as the configuration holds it.

    Lengths are shares of the object's extent (the longer side of its box), because the model sees
    the object scaled to one size, whatever its size in the log.

    Attributes:
        weight: how often it is drawn, relative to the others; 0 switches it off.
        severity: lowest and highest severity that is drawn, uniformly.
    """

    name: ClassVar[str]

    weight: Weight = 1.0
    severity: Shares = (0.1, 1.0)

    def __call__(self, rgba: Image, severity: float, rng: np.random.Generator) -> Image:
        """Spoil a picture.

        Args:
            rgba: (H, W, 4) uint8, straight alpha; passes `recast.trellis.check_crop`.
            severity: severity in [0, 1]; 0 changes next to nothing, 1 as much as the kind's figures
                say.
            rng: generator of all that is random; what is drawn does not depend on the severity, so
                equal generators give the same fault, weaker or stronger.

        Returns:
            (H, W, 4) uint8, straight alpha; a new array.
        """
        return self._run(rgba, find_object(rgba), severity, rng)

    @abstractmethod
    def _run(self, rgba: Image, box: ObjectBox, severity: float, rng: np.random.Generator) -> Image:
        """`__call__`, on the object's box."""


@dataclass(frozen=True)
class ObjectBox:
    """The object's box in its picture, in pixels: where alpha > 0.8; `left` column, `top` row."""

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


def find_object(rgba: Image) -> ObjectBox:
    """The box of a picture that passes `recast.trellis.check_crop`."""
    left, top, right, bottom = object_box(rgba[..., 3])
    return ObjectBox(left, top, right - left + 1, bottom - top + 1)


def shrinking(extent: float, smallest: float, severity: float) -> float:
    """Scale factor in (0, 1] that brings an object to `smallest` pixels at severity 1.

    Geometric in between: equal steps of severity lose equal shares. An object that is smaller
    already keeps its size.
    """
    return float(np.minimum(1.0, smallest / extent) ** severity)


def premultiplied(rgba: Image) -> Floats:
    """(H, W, 4) float32 in [0, 1]: colour times alpha, and alpha."""
    unit = np.asarray(rgba, np.float32) / 255
    unit[..., :3] *= unit[..., 3:]
    return unit


def straight(mixed: Floats) -> Image:
    """(H, W, 4) uint8 with straight alpha of premultiplied values; black where alpha is zero."""
    alpha = np.clip(mixed[..., 3], 0, 1)
    return with_alpha(mixed[..., :3] / np.maximum(alpha, 1e-6)[..., None], alpha)


def with_alpha(colour: Floats, alpha: Floats) -> Image:
    """(H, W, 4) uint8 of straight colours (H, W, 3) and alpha (H, W), both in [0, 1]."""
    levels = np.round(255 * np.clip(alpha, 0, 1)).astype(np.uint8)
    rgb = np.round(255 * np.clip(colour, 0, 1)).astype(np.uint8)
    rgb[levels == 0] = 0
    return np.dstack([rgb, levels])


def colour_and_alpha(rgba: Image) -> tuple[Floats, Floats]:
    """Straight colours (H, W, 3), black where alpha is zero, and alpha (H, W); in [0, 1]."""
    unit = np.asarray(rgba, np.float32) / 255
    unit[rgba[..., 3] == 0] = 0
    return unit[..., :3], unit[..., 3]


def value_noise(
    height: int, width: int, cell: float, rng: np.random.Generator, octaves: int = 3
) -> Floats:
    """Random field (height, width) float32 with mean about 0 and standard deviation about 1.

    Its largest lumps are `cell` pixels wide; each octave has lumps of half the size and strength.
    """
    total, power = np.zeros((height, width), np.float32), 0.0
    for octave in range(octaves):
        size = max(cell / 2**octave, 1.0)
        rows, columns = int(height / size) + 2, int(width / size) + 2
        grid = rng.standard_normal((rows, columns), np.float32)
        # Two knots beyond the field at most, so lumps keep their size at its borders.
        large = cv2.resize(
            grid, (round(columns * size) + 1, round(rows * size) + 1), interpolation=cv2.INTER_CUBIC
        )
        total += 0.5**octave * large[:height, :width]
        power += 0.25**octave
    return total / np.float32(0.75 * np.sqrt(power))


def signed_distance(alpha: Floats) -> Floats:
    """Pixels (H, W) to the nearest pixel across the edge of alpha > 0.5, less a half.

    So it is 0.5 in the first pixel inside and -0.5 in the first one outside.
    """
    inside = (alpha > 0.5).astype(np.uint8)
    within = cv2.distanceTransform(inside, cv2.DIST_L2, cv2.DIST_MASK_PRECISE)
    beyond = cv2.distanceTransform(1 - inside, cv2.DIST_L2, cv2.DIST_MASK_PRECISE)
    return np.where(inside > 0, within - 0.5, 0.5 - beyond).astype(np.float32)


def reveal(rgba: Image, alpha: Floats, behind: Floats) -> Image:
    """Give a picture (H, W, 4) another mask `alpha` (H, W) in [0, 1].

    Where that is larger, the display colours `behind` (H, W, 3) in [0, 1] are seen through it.
    """
    colour, before = colour_and_alpha(rgba)
    added = np.maximum(alpha - before, 0) / np.maximum(alpha, 1e-6)
    return with_alpha(colour + (behind - colour) * added[..., None], alpha)


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


def backdrop(rgba: Image, box: ObjectBox, rng: np.random.Generator) -> Floats:
    """A road, and what stands beyond it: (H, W, 3) float32 display colours in [0, 1].

    The horizon runs through the upper part of the object, as a car's camera sees other cars. The
    light is that of the object: where even its brightest parts are dark, the backdrop is dark.
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


def segmented(alpha: Floats, width: float) -> Floats:
    """Sharpen a blurred coverage (H, W) about one half, as segmenters cut sharply through any blur.

    `width` is that of the blurred edge in pixels; up to 1 the mask stays as it is.
    """
    return np.clip((alpha - 0.5) * max(width, 1.0) + 0.5, 0, 1)
