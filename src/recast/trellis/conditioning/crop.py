"""From a cut-out picture to the square crop that conditions the generation.

The published TRELLIS code crops in two ways: one rule in its pipeline, another in its training
data. Recast uses the pipeline's rule, `crop_to_object`, in training and in generation alike. Not
only do the two then agree; the trainer's rule follows every pixel whose alpha is not zero, so a
faint speck far from the object, as segmenters leave, shifts and shrinks the whole crop, where the
pipeline's rule looks at alpha above 0.8 only.
"""

from __future__ import annotations

from pathlib import Path

import numpy as np
from numpy.typing import NDArray
from PIL import Image

from recast.trellis.conditioning.read import Picture, check_crop, object_box

MARGIN = 1.2
"""Side of the square crop over the longer side of the object's box."""


def crop_to_object(rgba: Picture, size: int, where: str | Path = "crop") -> Picture:
    """Cut the square around the object, scale it, put it on black: recast's only rule.

    The object is where alpha exceeds 0.8. The square is centred on its box, has 1.2 times its
    longer side and may leave the picture, outside of which all is transparent. Equal to the last
    bit to the published pipeline with the same version of Pillow: Lanczos on premultiplied
    colours, then colour times alpha, cut off (not rounded) to 8 bits.

    Args:
        rgba: (H, W, 4) uint8, straight alpha.
        size: side of the result in pixels; 518 for DINOv2.
        where: file or source to name in an error.

    Returns:
        (size, size, 3) uint8 RGB on black.

    Raises:
        InputError: as `check_crop`.
    """
    check_crop(rgba, where)
    left, top, right, bottom = object_box(rgba[..., 3])
    centre_x, centre_y = (left + right) / 2, (top + bottom) / 2
    half = int(MARGIN * max(right - left, bottom - top)) // 2
    # Pillow rounds halves to even here, which the published pipeline leaves to it.
    box = (centre_x - half, centre_y - half, centre_x + half, centre_y + half)
    scaled = _scaled_crop(rgba, box, size)
    unit = np.asarray(scaled, np.float32) / 255
    return np.asarray(unit[..., :3] * unit[..., 3:] * 255).astype(np.uint8)


def training_crop(rgba: Picture, size: int, where: str | Path = "crop") -> NDArray[np.float32]:
    """The rule of the published trainer, kept to compare with; recast itself never uses it.

    Differs from `crop_to_object` in three ways: the object is wherever alpha is not zero (a faint
    speck shifts the crop), the square's borders are cut off to whole pixels instead of rounded,
    and the product of colour and alpha stays in float.

    Args:
        rgba: (H, W, 4) uint8, straight alpha.
        size: side of the result in pixels.
        where: file or source to name in an error.

    Returns:
        (3, size, size) float32 RGB on black, in [0, 1].

    Raises:
        InputError: as `check_crop`.
    """
    check_crop(rgba, where)
    left, top, right, bottom = object_box(rgba[..., 3], threshold=0)
    centre_x, centre_y = (left + right) / 2, (top + bottom) / 2
    half = max(right - left, bottom - top) / 2 * MARGIN
    corners = (centre_x - half, centre_y - half, centre_x + half, centre_y + half)
    scaled = _scaled_crop(rgba, tuple(int(value) for value in corners), size)
    unit = np.asarray(scaled, np.float32) / 255
    return np.ascontiguousarray((unit[..., :3] * unit[..., 3:]).transpose(2, 0, 1))


def _scaled_crop(rgba: Picture, box: tuple[float, ...], size: int) -> Image.Image:
    image = Image.fromarray(rgba)
    return image.crop(box).resize((size, size), Image.Resampling.LANCZOS)  # type: ignore[arg-type]
