"""One view on disk: a PNG with straight alpha."""

from __future__ import annotations

import struct
from pathlib import Path

import cv2
import numpy as np
from numpy.typing import NDArray

from recast.errors import InputError
from recast.recar.record import LARGEST_SIDE
from recast.storage import disk_errors, read_bytes

Image = NDArray[np.uint8]

HEADER_BYTES = 26
MOST_BYTES = 5 * LARGEST_SIDE**2
"""Most bytes of an encoded view: the largest one of noise, which does not pack, and some text."""

_SIGNATURE = b"\x89PNG\r\n\x1a\n"
_RGBA = 6  # PNG colour type of truecolour with alpha
_MEND = "replace the picture, or remove its identity from the set"


def encode_picture(rgba: Image) -> bytes:
    """PNG of an image (H, W, 4) uint8; colour without alpha becomes black, which packs better."""
    rgba = np.where(rgba[..., 3:] > 0, rgba, np.uint8(0))
    written, data = cv2.imencode(".png", cv2.cvtColor(rgba, cv2.COLOR_RGBA2BGRA))
    assert written
    return data.tobytes()


def check_header(path: Path, width: int, height: int) -> None:
    """Look at size and channels of a view without decoding it.

    Raises:
        InputError: missing, no PNG, of another size, or without alpha.
    """
    with disk_errors(path), path.open("rb") as file:
        head = file.read(HEADER_BYTES)
    check_encoded_header(head, path, width, height)


def check_encoded_header(head: bytes, where: str | Path, width: int, height: int) -> None:
    """`check_header` of the first `HEADER_BYTES` of a view, or of all of it."""
    head = head[:HEADER_BYTES]
    if len(head) < HEADER_BYTES or not head.startswith(_SIGNATURE) or head[12:16] != b"IHDR":
        raise InputError(where, "view", "is no PNG", _MEND)
    found_width, found_height, depth, colour_type = struct.unpack(">IIBB", head[16:26])
    if (found_width, found_height) != (width, height):
        raise InputError(
            where, "size", f"is {found_width}x{found_height} in a set of {width}x{height}", _MEND
        )
    if colour_type != _RGBA or depth != 8:
        raise InputError(
            where, "alpha", f"is absent (PNG colour type {colour_type}, {depth} bits)",
            "write 8-bit RGBA with the background removed",
        )  # fmt: skip


def read_picture(path: Path, width: int, height: int) -> Image:
    """Decode a view.

    Returns:
        (height, width, 4) uint8 RGBA, alpha straight (colours not multiplied by it).

    Raises:
        InputError: as `check_header`, or cut short, or transparent everywhere.
    """
    return decode_picture(read_bytes(path, MOST_BYTES), path, width, height)


def decode_picture(data: bytes, where: str | Path, width: int, height: int) -> Image:
    """`read_picture` of the bytes of a view; `where` is named by the errors."""
    check_encoded_header(data, where, width, height)
    try:
        bgra = cv2.imdecode(np.frombuffer(data, np.uint8), cv2.IMREAD_UNCHANGED)
    except cv2.error:
        bgra = None
    if bgra is None or bgra.shape != (height, width, 4) or bgra.dtype != np.uint8:
        raise InputError(where, "view", "cannot be decoded", _MEND)
    if not np.any(bgra[..., 3]):
        raise InputError(where, "alpha", "is zero everywhere", _MEND)
    return np.asarray(cv2.cvtColor(bgra, cv2.COLOR_BGRA2RGBA), np.uint8)
