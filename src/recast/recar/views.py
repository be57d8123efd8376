"""The views of a vehicle set, and folders of real crops, as they lie on disk.

The actor frame is that of all boxes: origin at the box centre, x forward, y left, z up. A camera at
azimuth a and elevation e stands at `distance * (cos e cos a, cos e sin a, sin e)` and looks at the
origin, level. So at azimuth 0 it looks at the front, and the vehicle's left side is to the right in
the image; at azimuth 90 it looks at the left side, and the front points to the left in the image.

Real crops are photographs of vehicles with masks, cut from driving logs:

    SET/ID/input_views/camera.json, frame_00.jpeg, mask_00.png, ...
    SET/ID/reserved_views/...

The input views are for making the vehicle, the reserved ones for judging it. camera.json describes
its pictures in lists of equal length: `frame_filenames`, `mask_filenames`, unit camera directions
`normalized_cam_positions`, `cam_dists` in metres and `cam_fovs` in degrees across the width; and
the vehicle's box, `object_lwh` in metres. Cameras are rectified pinholes, level, that look at the
box centre. Directions are in a box frame with +x to the rear, +y to the right and +z up, which is
ours turned half around.
"""

from __future__ import annotations

import struct
from collections.abc import Iterable
from dataclasses import dataclass
from pathlib import Path
from typing import Annotated, Any

import cv2
import numpy as np
from numpy.typing import ArrayLike, NDArray
from pydantic import BaseModel, ConfigDict, Field, FiniteFloat, ValidationError

from recast.arrays import Array, Image
from recast.cameras import PinholeCamera
from recast.core.errors import InputError
from recast.core.files import atomic_file, member, read_bytes, read_json
from recast.core.images import decode_image, decode_mask, opened, rgb, rgba
from recast.core.records import validation_error
from recast.geometry import boxes, se3
from recast.logs.images import encode

ELEVATION_DEG = 15.0
FOV_DEG = 40.0
MARGIN = 0.04
"""Share of the image that stays free at each edge, at the azimuth where the vehicle is widest."""

LARGEST_SIDE = 8192
"""Longest side of a picture of a set, pixels: decoded, it takes 268 MB at most."""
MOST_PIXELS = LARGEST_SIDE**2
"""Most pixels of a photograph: each takes some 30 bytes while it is brought to size, 2 GB."""
HEADER_BYTES = 26
MOST_BYTES = 5 * LARGEST_SIDE**2
"""Most bytes of an encoded view: the largest one of noise, which does not pack, and some text."""

INPUT_VIEWS, RESERVED_VIEWS = "input_views", "reserved_views"
CAMERA_FILE = "camera.json"

_SIGNATURE = b"\x89PNG\r\n\x1a\n"
_PANEL = (245, 246, 248)  # behind the vehicles of contact sheets
_RGBA = 6  # PNG colour type of truecolour with alpha
_MEND = "replace the image, or remove its identity from the set"
_UNIT_WITHIN = 1e-3
_SIZE_WITHIN = 1e-3  # metres between the boxes of both folders
_MEND_CROPS = "correct it; see docs/data.md#real-crops"

Text = Annotated[str, Field(min_length=1)]
Metres = Annotated[FiniteFloat, Field(gt=0)]
Direction = tuple[FiniteFloat, FiniteFloat, FiniteFloat]
Degrees = Annotated[FiniteFloat, Field(gt=0, lt=180)]


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


class _CameraRecord(BaseModel):
    """Contents of camera.json; members that are not named here are left alone."""

    model_config = ConfigDict(frozen=True, allow_inf_nan=False)

    frame_filenames: tuple[Text, ...] = Field(min_length=1)
    mask_filenames: tuple[Text, ...]
    normalized_cam_positions: tuple[Direction, ...]
    cam_dists: tuple[Metres, ...]
    cam_fovs: tuple[Degrees, ...]
    object_lwh: tuple[Metres, Metres, Metres]


@dataclass(frozen=True)
class RealView:
    """One photograph of a vehicle; decoded when asked for.

    Attributes:
        camera: rectified pinhole camera of the picture.
        actor_from_camera: (4, 4), actor frame: box centre, x forward, y left, z up.
    """

    image: Path
    mask: Path
    camera: PinholeCamera
    actor_from_camera: Array

    def rgba(self) -> Image:
        """(H, W, 4) uint8: the whole photograph, alpha 255 on the vehicle and 0 elsewhere.

        Raises:
            InputError: a file that cannot be decoded, or a mask that is empty.
        """
        colour, alpha = _decode(self.image, self.mask)
        if not np.any(alpha > 127):
            raise InputError(self.mask, "mask", "is empty", "mark the vehicle with 255")
        return np.dstack([colour, np.where(alpha > 127, np.uint8(255), np.uint8(0))])


@dataclass(frozen=True)
class RealVehicle:
    """A vehicle and its photographs.

    Attributes:
        size: (3,) length, width, height of its box, metres.
        inputs, reserved: its views; at least one of each.
    """

    id: str
    size: Array
    inputs: tuple[RealView, ...]
    reserved: tuple[RealView, ...]


def holds_real_crops(folder: str | Path) -> bool:
    """Whether `folder`, or a folder in it, has input views by this convention."""
    folder = Path(folder)
    return bool(_vehicle_folders(folder)) if folder.is_dir() else False


def read_real_crops(folder: str | Path) -> tuple[RealVehicle, ...]:
    """Read the vehicles of a folder, sorted by name; or the one vehicle whose folder it is.

    Pictures are opened to learn their size and not kept.

    Raises:
        InputError: no vehicle there; a file missing or undecodable; lists of different lengths; a
            direction that is not of unit length; a distance, angle of view or size that is not
            positive; picture and mask, or the boxes of both folders, of different sizes.
    """
    folder = Path(folder)
    if not folder.is_dir():
        raise InputError(folder, "vehicle crops", "is not a folder", "check the path")
    found = _vehicle_folders(folder)
    if not found:
        raise InputError(
            folder, "vehicle crops", f"holds no ID/{INPUT_VIEWS}/{CAMERA_FILE}", _MEND_CROPS
        )
    return tuple(_read_vehicle(path) for path in found)


def _vehicle_folders(folder: Path) -> list[Path]:
    if (folder / INPUT_VIEWS).is_dir():
        return [folder]
    return sorted(path for path in folder.iterdir() if (path / INPUT_VIEWS).is_dir())


def _read_vehicle(folder: Path) -> RealVehicle:
    size, inputs = _read_views(folder / INPUT_VIEWS)
    reserved_size, reserved = _read_views(folder / RESERVED_VIEWS)
    if not np.allclose(size, reserved_size, rtol=0.0, atol=_SIZE_WITHIN):
        problem = f"is {_metres(reserved_size)}, but {_metres(size)} in the input views"
        mend = "give both the same size"
        raise InputError(folder / RESERVED_VIEWS / CAMERA_FILE, "object_lwh", problem, mend)
    return RealVehicle(folder.resolve().name, size, inputs, reserved)


def _metres(size: Array) -> str:
    return " x ".join(f"{v:.3f}" for v in size)


def _read_views(folder: Path) -> tuple[Array, tuple[RealView, ...]]:
    path = folder / CAMERA_FILE
    value = read_json(path)
    try:
        record = _CameraRecord.model_validate(value)
    except ValidationError as error:
        raise validation_error(path, error, _MEND_CROPS) from None
    frames = len(record.frame_filenames)
    for field in ("mask_filenames", "normalized_cam_positions", "cam_dists", "cam_fovs"):
        count = len(getattr(record, field))
        if count != frames:
            problem = f"has {count} entries for {frames} in frame_filenames"
            raise InputError(path, field, problem, "give one for every frame")
    views = tuple(_read_view(path, record, index) for index in range(frames))
    return np.array(record.object_lwh), views


def _read_view(path: Path, record: _CameraRecord, index: int) -> RealView:
    x, y, z = record.normalized_cam_positions[index]
    length = float(np.linalg.norm((x, y, z)))
    if abs(length - 1) > _UNIT_WITHIN:
        problem = f"has length {length:.4g}"
        mend = "normalise it, and put its length into cam_dists"
        raise InputError(path, f"normalized_cam_positions.{index}", problem, mend)
    names = record.frame_filenames[index], record.mask_filenames[index]
    image = member(path.parent, names[0], path, f"frame_filenames.{index}")
    mask = member(path.parent, names[1], path, f"mask_filenames.{index}")
    height, width = _decode(image, mask)[1].shape
    azimuth = float(np.degrees(np.arctan2(-y, -x)))
    elevation = float(np.degrees(np.arcsin(z / length)))
    return RealView(
        image=image,
        mask=mask,
        camera=pinhole(width, height, record.cam_fovs[index]),
        actor_from_camera=camera_pose(azimuth, elevation, record.cam_dists[index]),
    )


def _decode(image: Path, mask: Path) -> tuple[Image, Image]:
    """Colours (H, W, 3) and the mask (H, W) of a picture, upright."""
    mend = "save it again as JPEG or PNG"
    colours = rgb(decode_image(image, image, most_pixels=MOST_PIXELS, mend=mend))
    size = colours.shape[1], colours.shape[0]
    return colours, decode_mask(mask, mask, size, image.name, most_pixels=MOST_PIXELS, mend=mend)
