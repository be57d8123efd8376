"""What a mesh file names: textures, material libraries and buffers, all in its own folder."""

from __future__ import annotations

import base64
import io
import math
from pathlib import Path
from urllib.parse import unquote

import numpy as np
from numpy.typing import NDArray
from PIL import Image

from recast import storage
from recast.errors import InputError
from recast.names import member

MOST_BYTES = 1 << 29
"""Of a mesh file, and of any file that it names."""
MOST_PIXELS = 1 << 26
"""Of a texture, as its header says."""
MOST_TEXTURES = 32
_KEPT_EDGE = 2048  # pixels: finer than a vehicle is sampled
_FORMATS = ("PNG", "JPEG", "WEBP", "BMP", "TGA", "TIFF")  # those whose readers only decode


def named_file(path: Path, name: str, what: str) -> Path:
    """The file that a mesh file names; it lies in the mesh's folder or below it.

    Args:
        path: the mesh file.
        name: as it stands there; OBJ from Windows has backslashes.
        what: member of the mesh file, for messages.

    Raises:
        InputError: the name leads out of the folder.
    """
    return member(path.parent, name.replace("\\", "/"), path, what)


def named_uri(path: Path, uri: str, what: str) -> Path | None:
    """The file that a glTF URI names, see `named_file`; None if the data stands in the URI."""
    return None if uri.startswith("data:") else named_file(path, unquote(uri), what)


def data_of(path: Path, uri: str, what: str) -> bytes:
    """The bytes of a glTF URI: base64 in place, or a file.

    Raises:
        InputError: the base64 is broken, or see `named_file` and `storage.read_bytes`.
    """
    file = named_uri(path, uri, what)
    if file is not None:
        return storage.read_bytes(file, MOST_BYTES)
    head, _, text = uri.partition(",")
    try:
        if head.endswith(";base64"):
            return base64.b64decode(text, validate=True)
    except ValueError:
        pass
    raise InputError(path, what, "is no base64", "export it again")


def decoded(path: Path, data: bytes, what: str) -> NDArray[np.uint8]:
    """A texture, (H, W, 4) sRGB and alpha, averaged until no edge is above 2048 pixels.

    Raises:
        InputError: no whole picture of a known format, or one of more than `MOST_PIXELS`.
    """
    try:
        with Image.open(io.BytesIO(data), formats=_FORMATS) as image:
            width, height = image.size
            if width * height <= MOST_PIXELS:
                smaller = math.ceil(max(width, height) / _KEPT_EDGE)
                return np.array(image.convert("RGBA").reduce(smaller))
    except Exception as error:  # Pillow's parsers let through whatever broken bytes lead to
        known = ", ".join(_FORMATS)
        raise InputError(path, what, f"is no whole picture ({error})", f"use {known}") from None
    problem = f"has {width}x{height} pixels, {MOST_PIXELS} are read at most"
    raise InputError(path, what, problem, "scale it down")
