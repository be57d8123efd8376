"""The views of a vehicle set: where their cameras stand, and how they lie on disk.

The actor frame is that of all boxes: origin at the box centre, x forward, y left, z up. A camera at
azimuth a and elevation e stands at `distance * (cos e cos a, cos e sin a, sin e)` and looks at the
origin, level. So at azimuth 0 it looks at the front, and the vehicle's left side is to the right in
the image; at azimuth 90 it looks at the left side, and the front points to the left in the image.
"""

from __future__ import annotations

import struct
from collections.abc import Iterable
from pathlib import Path
from typing import Any

import cv2
import numpy as np
from numpy.typing import ArrayLike, NDArray

from recast.arrays import Array, Image
from recast.cameras import PinholeCamera
from recast.core.errors import InputError
from recast.core.files import atomic_file, read_bytes
from recast.core.images import opened, rgba
from recast.geometry import boxes, se3
from recast.logs.images import encode

ELEVATION_DEG = 15.0
FOV_DEG = 40.0
MARGIN = 0.04
"""Share of the image that stays free at each edge, at the azimuth where the vehicle is widest."""

LARGEST_SIDE = 8192
"""Longest side of a picture of a set, pixels: decoded, it takes 268 MB at most."""
HEADER_BYTES = 26
MOST_BYTES = 5 * LARGEST_SIDE**2
"""Most bytes of an encoded view: the largest one of noise, which does not pack, and some text."""

_SIGNATURE = b"\x89PNG\r\n\x1a\n"
_PANEL = (245, 246, 248)  # behind the vehicles of contact sheets
_RGBA = 6  # PNG colour type of truecolour with alpha
_MEND = "replace the image, or remove its identity from the set"


def pinhole(width: int, height: int, fov_deg: float) -> PinholeCamera:
    """A camera with `fov_deg` across its width, square pixels, principal point in the middle."""
    focal = width / 2 / float(np.tan(np.radians(fov_deg) / 2))
    return PinholeCamera(width, height, focal, focal, width / 2, height / 2)


def camera_pose(azimuth_deg: float, elevation_deg: float, distance: float) -> Array:
    """`actor_from_camera` (4, 4) of the level OpenCV camera there that looks at the box centre."""
    a, e = np.radians(azimuth_deg), np.radians(elevation_deg)
    forward = -se3.direction(a, e)
    right = np.array([-np.sin(a), np.cos(a), 0.0])
    rotation = np.stack([right, np.cross(forward, right), forward], axis=1)
    return se3.from_rotation_translation(rotation, -distance * forward)


def fitting_distance(
    size: ArrayLike,
    camera: PinholeCamera,
    elevation_deg: float = ELEVATION_DEG,
    margin: float = MARGIN,
    azimuths_deg: Iterable[float] = range(91),
) -> float:
    """Metres at which a box of `size` (3,) just fits the image from all azimuths given.

    Args:
        size: length, width, height in metres.
        camera: rectified camera with the principal point in the middle.
        margin: share of width and height that stays free at each edge.
        azimuths_deg: azimuths to fit at; a quarter is as good as all of them, by symmetry of the
            box.
    """
    corners = boxes.corners(size)
    least = 0.0
    for azimuth in azimuths_deg:
        # About the centre, in camera axes: a corner at depth d + z is inside while
        # f |x| <= (1/2 - margin) width (d + z), and alike for y.
        about = corners @ camera_pose(azimuth, elevation_deg, 0.0)[:3, :3]
        across = np.abs(about[:, 0]) * camera.fx / ((0.5 - margin) * camera.width)
        upright = np.abs(about[:, 1]) * camera.fy / ((0.5 - margin) * camera.height)
        least = max(least, float(np.max(np.maximum(across, upright) - about[:, 2])))
    return least


def encode_picture(rgba: Image) -> bytes:
    """PNG of an image (H, W, 4) uint8; colour without alpha becomes black, which packs better."""
    rgba = np.where(rgba[..., 3:] > 0, rgba, np.uint8(0))
    return encode(rgba)


def shrunk(rgba: Image, width: int, height: int) -> NDArray[np.float32]:
    """Shrunk to fit `width` x `height`: colour times alpha, and alpha, in [0, 1]."""
    alpha = rgba[..., 3:].astype(np.float32) / 255
    light = np.concatenate([rgba[..., :3] * (alpha / 255), alpha], axis=-1)
    scale = min(width / rgba.shape[1], height / rgba.shape[0])
    size = (max(round(rgba.shape[1] * scale), 1), max(round(rgba.shape[0] * scale), 1))
    return np.asarray(cv2.resize(light, size, interpolation=cv2.INTER_AREA), np.float32)


def over_panel(cell: NDArray[np.float32]) -> Image:
    """What `shrunk` gave before a light panel, with a thin white line to the cells beside it."""
    over = 255 * cell[..., :3] + np.array(_PANEL, np.float32) * (1 - cell[..., 3:])
    over[:1], over[:, :1] = 255, 255
    return np.clip(np.round(over), 0, 255).astype(np.uint8)


def check_header(head: bytes, where: str | Path, width: int, height: int) -> None:
    """Look at size and channels of a view by its first `HEADER_BYTES`; `where` is for messages.

    Raises:
        InputError: no PNG, of another size, or without alpha.
    """
    head = head[:HEADER_BYTES]
    if len(head) < HEADER_BYTES or not head.startswith(_SIGNATURE) or head[12:16] != b"IHDR":
        raise InputError(where, "view", "is not a PNG file", _MEND)
    found_width, found_height, depth, colour_type = struct.unpack(">IIBB", head[16:26])
    if (found_width, found_height) != (width, height):
        raise InputError(
            where, "size", f"is {found_width}x{found_height}, expected {width}x{height}", _MEND
        )
    if colour_type != _RGBA or depth != 8:
        problem = f"is absent (PNG colour type {colour_type}, {depth} bits)"
        raise InputError(where, "alpha", problem, "write 8-bit RGBA with the background removed")


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
    check_header(data, where, width, height)
    with opened(data, where, ("PNG",), what="view", mend=_MEND) as image:
        if image.turned:
            raise InputError(where, "orientation", "is not upright (EXIF)", "save it upright")
        picture = rgba(image.levels())
    if not np.any(picture[..., 3]):
        raise InputError(where, "alpha", "is zero everywhere", _MEND)
    return picture


def write_arrays(path: Path, **arrays: NDArray[Any]) -> None:
    """Write named arrays; the same arrays give the same bytes.

    Raises:
        InputError: the disk is full.
    """
    with atomic_file(path) as partial, partial.open("wb") as stream:
        np.savez_compressed(stream, allow_pickle=False, **arrays)
