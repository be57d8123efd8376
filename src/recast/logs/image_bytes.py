"""Encoded images from outside, decoded only where their size is the one that is expected."""

from __future__ import annotations

import io
from pathlib import Path

import numpy as np
from PIL.JpegImagePlugin import JpegImageFile
from PIL.PngImagePlugin import PngImageFile

from recast.errors import InputError
from recast.logs.types import Image

# Not PIL.Image.open: other formats call other programs, and it warns of large images, which are
# measured here.
READERS: dict[str, type[PngImageFile] | type[JpegImageFile]] = {
    "png": PngImageFile,
    "jpeg": JpegImageFile,
}


def decode(
    data: bytes, kind: str, size: tuple[int, int], where: str | Path, says: str, mode: str = "RGB"
) -> Image:
    """The pixels of an encoded image: (height, width, 3) uint8 of mode "RGB", or (height, width) of
    mode "L".

    Args:
        kind: "png" or "jpeg".
        size: width and height in pixels that it must have.
        where: file that holds it, for messages.
        says: what says that size, for messages.

    Raises:
        InputError: it is of another kind or size, cut off or damaged.
    """
    if kind not in READERS:
        raise InputError(where, "image", f"is {kind!r}, not png or jpeg", "convert it")
    try:
        with READERS[kind](io.BytesIO(data)) as image:
            if image.size == size:
                return np.array(image.convert(mode))
            found = image.size
    except Exception as error:  # Pillow raises of many kinds for damaged files
        problem = f"cannot be decoded ({error})"
        raise InputError(where, "image", problem, "download it again") from None
    raise InputError(
        where, "image size",
        f"is {found[0]}x{found[1]}, {says} says {size[0]}x{size[1]}",
        "take images and calibration of the same recording",
    )  # fmt: skip
