"""Pictures of one cut-out object from disk, and the checks that spare a wasted generation."""

from __future__ import annotations

from pathlib import Path

import numpy as np
from numpy.typing import NDArray
from PIL import Image, ImageOps

from recast.errors import InputError

Picture = NDArray[np.uint8]

OPAQUE = 204
"""Alpha above this value (0.8 of 255) belongs to the object, as in the published pipeline."""

SMALLEST = 8
"""Pixels of an object's longer side below which there is nothing to generate from."""

_SEGMENT = (
    "cut the object out (a mask as alpha, PNG), or let `recast actor make` cut it out of a log"
)
_ALPHA_MODES = ("RGBA", "RGBa", "LA", "PA")


def read_crop(path: str | Path) -> Picture:
    """Read and check the picture of one cut-out object.

    Anything with alpha that Pillow decodes is taken: 8 and 16 bits, palettes, grey with alpha,
    one transparent colour. A stored orientation (EXIF) is applied.

    Returns:
        (H, W, 4) uint8 RGBA, straight alpha (colours not multiplied by it).

    Raises:
        InputError: missing, unreadable or cut short, without alpha, or refused by `check_crop`.
    """
    try:
        with Image.open(path) as file:
            image = ImageOps.exif_transpose(file)
            if image.mode not in _ALPHA_MODES and "transparency" not in image.info:
                raise InputError(path, "alpha", f"is absent (mode {image.mode})", _SEGMENT)
            rgba = np.array(image.convert("RGBA"))
    except FileNotFoundError:
        raise InputError(path, "picture", "is missing", "check the path") from None
    except InputError:
        raise
    except (OSError, SyntaxError, ValueError, EOFError, Image.DecompressionBombError) as error:
        reason = str(error).replace(f" {str(path)!r}", "").rstrip(".")
        raise InputError(
            path, "picture", f"cannot be read ({reason})", "save it anew as PNG with alpha"
        ) from None
    check_crop(rgba, path)
    return rgba


def check_crop(rgba: Picture, where: str | Path) -> None:
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
            where, "alpha", "is zero everywhere: the picture shows nothing", "check the mask"
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
            where, "object", f"is {width}x{height} pixels, at least {SMALLEST} are needed",
            "take a closer view, or clean the mask",
        )  # fmt: skip


def object_box(alpha: Picture, threshold: int = OPAQUE) -> tuple[int, int, int, int]:
    """First and last column and row with alpha above `threshold`, all inclusive.

    Args:
        alpha: (H, W) uint8 with at least one such pixel.

    Returns:
        left, top, right, bottom in pixels.
    """
    inside = alpha > threshold
    columns, rows = np.flatnonzero(inside.any(axis=0)), np.flatnonzero(inside.any(axis=1))
    return int(columns[0]), int(rows[0]), int(columns[-1]), int(rows[-1])
