"""Encoded images from outside, decoded only if their size is the one that is expected."""

from __future__ import annotations

import io
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path

import numpy as np
from PIL.JpegImagePlugin import JpegImageFile
from PIL.PngImagePlugin import PngImageFile

from recast.errors import InputError
from recast.logs.types import Image

# Not PIL.Image.open: other formats call other programs, and it warns of large images, which are
# measured here.
_READERS: dict[str, type[PngImageFile] | type[JpegImageFile]] = {
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
    with _opened(data, kind, where) as image:
        require_size(image.size, size, where, says)
        return np.array(image.convert(mode))


def size_of(data: bytes, kind: str, where: str | Path) -> tuple[int, int]:
    """Width and height that an encoded image says; its pixels are not decoded.

    Args:
        kind: "png" or "jpeg".
        where: file that holds it, for messages.

    Raises:
        InputError: it is of another kind or damaged.
    """
    with _opened(data, kind, where) as image:
        return image.size


def require_size(
    found: tuple[int, int], size: tuple[int, int], where: str | Path, says: str
) -> None:
    """Check the width and height of an image; arguments as of `decode`.

    Raises:
        InputError: they differ.
    """
    if found != size:
        raise InputError(
            where, "image size",
            f"is {found[0]}x{found[1]}, {says} says {size[0]}x{size[1]}",
            "take images and calibration of the same recording",
        )  # fmt: skip


@contextmanager
def _opened(data: bytes, kind: str, where: str | Path) -> Iterator[PngImageFile | JpegImageFile]:
    """The image, its header read, its pixels not yet."""
    if kind not in _READERS:
        raise InputError(where, "image", f"is {kind!r}, not png or jpeg", "convert it")
    try:
        with _READERS[kind](io.BytesIO(data)) as image:
            yield image
    except InputError:
        raise
    except Exception as error:  # Pillow raises of many kinds for damaged files
        problem = f"cannot be decoded ({error})"
        raise InputError(where, "image", problem, "download it again") from None
