"""The sky map as an image file: equirectangular, zenith in the top row, azimuth from -pi to pi."""

from __future__ import annotations

from pathlib import Path

import cv2
import numpy as np
import torch

from recast.errors import InputError
from recast.logs.importers.image_files import image_size
from recast.scene.sky import SkyMap
from recast.storage import write_bytes

MOST_PIXELS = 1 << 25
"""Most pixels of a sky image: 8192 x 4096, 0.04 degrees a column."""
DEPTHS = {np.dtype(np.uint8): 255.0, np.dtype(np.uint16): 65535.0}


def write_sky(path: str | Path, sky: SkyMap) -> None:
    """Write a PNG with 16 bits a channel, in which no colour is off by more than 1e-5."""
    levels = np.rint(sky.colours.clamp(0, 1).numpy() * 65535).astype(np.uint16)
    _, data = cv2.imencode(".png", levels[..., ::-1])
    write_bytes(path, data.tobytes())


def read_sky(path: str | Path) -> SkyMap:
    """Read an RGB image of 8 or 16 bits a channel.

    Raises:
        InputError: the file is missing, no image, too large, or of another kind.
    """
    path = Path(path)
    width, height = image_size(path)
    if width * height > MOST_PIXELS:
        problem = f"is of {width}x{height}, at most {MOST_PIXELS} pixels are read"
        raise InputError(path, "sky image", problem, "make it smaller")
    pixels = cv2.imdecode(np.fromfile(path, np.uint8), cv2.IMREAD_UNCHANGED)
    if pixels is None:
        raise InputError(path, "sky image", "is no image, or cut short", "write it anew")
    if pixels.ndim != 3 or pixels.shape[2] != 3 or pixels.dtype not in DEPTHS:
        raise InputError(
            path, "sky image", f"is {pixels.shape} {pixels.dtype}", "write RGB of 8 or 16 bits"
        )
    colours = pixels[..., ::-1].astype(np.float32) / np.float32(DEPTHS[pixels.dtype])
    return SkyMap(torch.from_numpy(np.ascontiguousarray(colours)))
