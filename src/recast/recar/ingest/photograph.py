"""One photograph: read, brought to the size of the set."""

from __future__ import annotations

import re
import warnings
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path

import cv2
import numpy as np
from numpy.typing import NDArray
from PIL import Image as Pillow
from PIL import ImageOps

from recast.errors import InputError
from recast.recar.picture import Image

SUFFIXES = (".bmp", ".jpeg", ".jpg", ".png", ".tif", ".tiff", ".webp")
_MODES = ("1", "CMYK", "L", "LA", "P", "PA", "RGB", "RGBA", "RGBX", "YCbCr")
_ORIENTATION = 0x0112  # EXIF tag; from 5 on the picture lies on its side
_MEND = "replace the photograph"


def natural_order(path: Path) -> tuple[list[tuple[int, int, str]], str]:
    """Sorts 2.jpg before 10.jpg."""
    parts = re.findall(r"\d+|\D+", path.name.lower())
    return [(0, int(part), "") if part.isdecimal() else (1, 0, part) for part in parts], path.name


def photograph_size(path: Path) -> tuple[int, int]:
    """Width and height, upright, from the header.

    Raises:
        InputError: it is no picture, or not one of 8 bits.
    """
    with _reading(path), Pillow.open(path) as picture:
        _check_mode(path, picture)
        width, height = picture.size
        # Pillow decodes all of a PNG to look for EXIF data at its end.
        told = picture.format != "PNG" or "exif" in picture.info
        turned = told and picture.getexif().get(_ORIENTATION, 1) >= 5
        return (height, width) if turned else (width, height)


def read_photograph(path: Path) -> tuple[Image, NDArray[np.uint8] | None]:
    """Colour (H, W, 3) and alpha (H, W), upright; None where nothing is transparent.

    Raises:
        InputError: as `photograph_size`, or cut short, or transparent everywhere.
    """
    with _reading(path), Pillow.open(path) as picture:
        _check_mode(path, picture)
        transparent = "A" in picture.mode or "transparency" in picture.info
        upright = ImageOps.exif_transpose(picture).convert("RGBA" if transparent else "RGB")
        pixels = np.asarray(upright)
    if not transparent or (pixels[..., 3] == 255).all():
        return np.ascontiguousarray(pixels[..., :3]), None
    if not pixels[..., 3].any():
        raise InputError(path, "alpha", "is zero everywhere", _MEND)
    return np.ascontiguousarray(pixels[..., :3]), np.ascontiguousarray(pixels[..., 3])


def fit(rgb: Image, alpha: NDArray[np.uint8], width: int, height: int) -> Image:
    """Scaled to fit `width` x `height` and centred there, transparent beside it: (H, W, 4).

    Colours are weighed by alpha, so that no background bleeds into the vehicle's edge.
    """
    scale = min(width / rgb.shape[1], height / rgb.shape[0])
    size = (max(round(rgb.shape[1] * scale), 1), max(round(rgb.shape[0] * scale), 1))
    top, left = (height - size[1]) // 2, (width - size[0]) // 2
    fitted = np.zeros((height, width, 4), np.uint8)
    if size == rgb.shape[1::-1]:
        part = np.dstack([rgb, alpha])
    else:
        share = alpha[..., None].astype(np.float32)
        weighed = np.concatenate([rgb * (share / 255), share], axis=-1)
        way = cv2.INTER_AREA if scale < 1 else cv2.INTER_LINEAR
        scaled = cv2.resize(weighed, size, interpolation=way)
        colour = scaled[..., :3] * (255 / np.maximum(scaled[..., 3:], 1e-3))
        part = np.concatenate([colour, scaled[..., 3:]], axis=-1)
        part = np.clip(np.round(part), 0, 255).astype(np.uint8)
    fitted[top : top + size[1], left : left + size[0]] = part
    return fitted


def _check_mode(path: Path, picture: Pillow.Image) -> None:
    if picture.mode not in _MODES:
        raise InputError(path, "pixels", f"are of the kind {picture.mode}", "save it with 8 bits")


@contextmanager
def _reading(path: Path) -> Iterator[None]:
    try:
        with warnings.catch_warnings():
            warnings.simplefilter("ignore", Pillow.DecompressionBombWarning)
            yield
    except InputError:
        raise
    except FileNotFoundError:
        raise InputError(path, "photograph", "is missing", "restore it") from None
    except (OSError, ValueError, SyntaxError, Pillow.DecompressionBombError) as error:
        problem = f"cannot be read ({str(error).splitlines()[0] if str(error) else 'broken'})"
        raise InputError(path, "photograph", problem, _MEND) from None
