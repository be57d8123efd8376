"""Folders of real vehicle crops with masks, cut from driving logs.

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

from dataclasses import dataclass
from pathlib import Path
from typing import Annotated

import numpy as np
from pydantic import BaseModel, ConfigDict, Field, FiniteFloat, ValidationError

from recast.arrays import Array, Image
from recast.cameras import PinholeCamera
from recast.core.errors import InputError
from recast.core.files import member, read_json
from recast.core.images import decode_image, decode_mask, rgb
from recast.core.records import validation_error
from recast.recar.ingest_photograph import MOST_PIXELS
from recast.recar.vehicle_set import Metres, Text
from recast.recar.views import camera_pose, pinhole

INPUT_VIEWS, RESERVED_VIEWS = "input_views", "reserved_views"
CAMERA_FILE = "camera.json"
_UNIT_WITHIN = 1e-3
_SIZE_WITHIN = 1e-3  # metres between the boxes of both folders
_MEND = "correct it; see docs/data.md#real-crops"

Direction = tuple[FiniteFloat, FiniteFloat, FiniteFloat]
Degrees = Annotated[FiniteFloat, Field(gt=0, lt=180)]


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
        raise InputError(folder, "vehicle crops", f"holds no ID/{INPUT_VIEWS}/{CAMERA_FILE}", _MEND)
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
        raise validation_error(path, error, _MEND) from None
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
