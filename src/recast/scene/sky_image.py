"""The sky map as an image file: equirectangular, zenith in the top row, azimuth from -pi to pi."""

from __future__ import annotations

from pathlib import Path

import cv2
import numpy as np
import torch

from recast.errors import InputError
from recast.scene.sky import SkyMap
from recast.storage import write_bytes

DEPTHS = {np.dtype(np.uint8): 255.0, np.dtype(np.uint16): 65535.0}


def write_sky(path: str | Path, sky: SkyMap) -> None:
    """Write a PNG with 16 bits a channel, in which no colour is off by more than 1e-5."""
    levels = np.rint(sky.colours.clamp(0, 1).numpy() * 65535).astype(np.uint16)
    _, data = cv2.imencode(".png", levels[..., ::-1])
    write_bytes(path, data.tobytes())


def read_sky(path: str | Path) -> SkyMap:
    """Read an RGB image of 8 or 16 bits a channel.

    Raises:
        InputError: the file is missing, no image, or of another kind.
    """
    path = Path(path)
    try:
        data = np.frombuffer(path.read_bytes(), np.uint8)
    except OSError as error:
        problem = (error.strerror or "cannot be read").lower()
        raise InputError(path, "sky image", problem, "check the path") from None
    pixels = cv2.imdecode(data, cv2.IMREAD_UNCHANGED) if len(data) else None
    if pixels is None:
        raise InputError(path, "sky image", "is no image, or cut short", "write it anew")
    if pixels.ndim != 3 or pixels.shape[2] != 3 or pixels.dtype not in DEPTHS:
        raise InputError(
            path, "sky image", f"is {pixels.shape} {pixels.dtype}", "write RGB of 8 or 16 bits"
        )
    colours = pixels[..., ::-1].astype(np.float32) / np.float32(DEPTHS[pixels.dtype])
    return SkyMap(torch.from_numpy(np.ascontiguousarray(colours)))
