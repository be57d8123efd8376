"""Pictures of one cut-out object: read and checked, and cropped to the square that conditions.

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
from PIL import Image as PilImage

from recast.arrays import Image
from recast.core.errors import InputError
from recast.core.images import FORMATS, decode_image, eight_bits

OPAQUE = 204
"""Alpha above this value (0.8 of 255) belongs to the object, as in the published pipeline."""

SMALLEST = 8
"""Pixels of an object's longer side below which there is nothing to generate from."""

_SEGMENT = "cut the object out (PNG with an alpha mask), or let `recast actor make` do it from logs"
MARGIN = 1.2
"""Side of the square crop over the longer side of the object's box."""


def read_crop(path: str | Path) -> Image:
    """Read and check the picture of one cut-out object.

    PNG, WebP, TIFF and GIF are taken: 8 and 16 bits, palettes, grey with alpha, one transparent
    colour. A stored orientation (EXIF) is applied.

    Returns:
        (H, W, 4) uint8 RGBA, straight alpha (colours not multiplied by it).

    Raises:
        InputError: missing, unreadable or cut short, without alpha, or refused by `check_crop`.
    """
    path = Path(path)
    levels = decode_image(path, path, (*FORMATS, "GIF"))
    if levels.shape[2:] != (4,):
        raise InputError(path, "alpha", "is absent", _SEGMENT)
    rgba = eight_bits(levels)
    check_crop(rgba, path)
    return rgba


def check_crop(rgba: Image, where: str | Path) -> None:
    """Refuse a picture that holds no cut-out object.

    Args:
        rgba: (H, W, 4) uint8, straight alpha.
        where: file or source to name in the error.

    Raises:
        InputError: no alpha channel, transparent everywhere, opaque everywhere, alpha nowhere
            above 0.8, or an object whose longer side is less than `SMALLEST` pixels.
    """
    if rgba.ndim != 3 or rgba.shape[2] != 4 or rgba.dtype != np.uint8:
        shape = "x".join(str(n) for n in rgba.shape)
        raise InputError(where, "alpha", f"is absent ({shape} {rgba.dtype})", _SEGMENT)
    alpha = rgba[..., 3]
    strongest = int(alpha.max(initial=0))
    if strongest == 0:
        raise InputError(
            where, "alpha", "is zero everywhere: the image shows nothing", "check the mask"
        )
    if strongest <= OPAQUE:
        problem = f"never exceeds 0.8 (largest {strongest / 255:.2f}): no object stands out"
        raise InputError(where, "alpha", problem, "make the mask opaque on the object")
    if int(alpha.min()) > OPAQUE:
        raise InputError(where, "alpha", "is opaque everywhere: no object is cut out", _SEGMENT)
    left, top, right, bottom = object_box(alpha)
    width, height = right - left + 1, bottom - top + 1
    if max(width, height) < SMALLEST:
        raise InputError(
            where,
            "object",
            f"is {width}x{height} pixels, at least {SMALLEST} are needed",
            "use a closer view, or clean the mask",
        )


def object_box(alpha: Image, threshold: int = OPAQUE) -> tuple[int, int, int, int]:
    """Left, top, right, bottom in pixels, all inclusive, of where alpha is above `threshold`.

    Args:
        alpha: (H, W) uint8 with at least one such pixel.
    """
    inside = alpha > threshold
    columns, rows = np.flatnonzero(inside.any(axis=0)), np.flatnonzero(inside.any(axis=1))
    return int(columns[0]), int(rows[0]), int(columns[-1]), int(rows[-1])


def crop_to_object(rgba: Image, size: int, where: str | Path = "crop") -> Image:
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


def training_crop(rgba: Image, size: int, where: str | Path = "crop") -> NDArray[np.float32]:
    """The rule of the published trainer, kept to compare with; recast itself never uses it.

    Differs from `crop_to_object` in three ways: the object is wherever alpha is not zero (a faint
    speck shifts the crop), the square's borders are cut off to whole pixels instead of rounded,
    and the product of colour and alpha stays in float.

    Args:
        rgba, size, where: see `crop_to_object`.

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


def _scaled_crop(rgba: Image, box: tuple[float, ...], size: int) -> PilImage.Image:
    image = PilImage.fromarray(rgba)
    return image.crop(box).resize((size, size), PilImage.Resampling.LANCZOS)  # type: ignore[arg-type]
