"""Waymo cameras: calibration, images and their rolling shutter.

Waymo's camera frame is x forward, y left, z up; its distortion is OpenCV's, on u = -y / x and
v = -z / x. Pixel coordinates are continuous, 0 at the left edge of the first pixel: as ours.
"""

from __future__ import annotations

import io
import json
from collections.abc import Mapping
from dataclasses import dataclass

import numpy as np
from PIL import Image as PillowImage

from recast.errors import InputError
from recast.geometry import PinholeCamera, se3
from recast.logs.importers.waymo_segment import (
    ImageEntry,
    Segment,
    record_errors,
    transform,
)
from recast.logs.importers.waymo_wire import FieldError, Message
from recast.logs.types import Array, CameraStream, Image

WAYMO_FROM_OPENCV = se3.from_rotation_translation(
    np.array([[0.0, 0.0, 1.0], [-1.0, 0.0, 0.0], [0.0, -1.0, 0.0]]), np.zeros(3)
)


@dataclass(frozen=True)
class WaymoImages:
    """The images of one camera in a segment's file; an `EncodedImageSource`.

    Attributes:
        entries: in the order of time.
        camera: intrinsics, which tell the size that every image must have.
    """

    entries: tuple[ImageEntry, ...]
    camera: PinholeCamera

    def __len__(self) -> int:
        """Number of frames."""
        return len(self.entries)

    def __getitem__(self, index: int) -> Image:
        """Decode frame `index` to (height, width, 3) uint8 RGB."""
        data = self.entries[index].jpeg.read()
        with self._open(index, data) as image:
            try:
                return np.array(image.convert("RGB"))
            except (OSError, SyntaxError, ValueError) as error:
                raise self._undecodable(index, error) from None

    def encoded(self, index: int) -> tuple[bytes, str]:
        """The JPEG file as it is in the record, whose checksum has been compared.

        Raises:
            InputError: it is no JPEG, or of another size than the calibration says.
        """
        data = self.entries[index].jpeg.read()
        self._open(index, data).close()
        return data, "jpeg"

    def _open(self, index: int, data: bytes) -> PillowImage.Image:
        try:
            image = PillowImage.open(io.BytesIO(data), formats=["JPEG"])
        except (OSError, SyntaxError, ValueError) as error:
            raise self._undecodable(index, error) from None
        if image.size != (self.camera.width, self.camera.height):
            raise self.entries[index].jpeg.error(
                f"is {image.width}x{image.height}, the camera's calibration says "
                f"{self.camera.width}x{self.camera.height}"
            )
        return image

    def _undecodable(self, index: int, error: Exception) -> InputError:
        return self.entries[index].jpeg.error(f"cannot be decoded ({error})")


def read_cameras(segment: Segment) -> dict[str, CameraStream]:
    """The cameras of a segment by name; those without images keep their calibration.

    Raises:
        InputError: a calibration is wrong or missing, or images of a camera are out of order.
    """
    with record_errors(segment.path, segment.frames[0].record):
        calibrations = {
            message["name"]: message for message in segment.context["camera_calibrations"]
        }
        known = {name: _calibration(message) for name, message in calibrations.items()}
    streams = {}
    for frame in segment.frames:
        for name, image in frame.images.items():
            if name not in known:
                raise image.jpeg.error(
                    f"there is no calibration of camera {name} in the first frame's context"
                )
    for name, (camera, rig_from_camera) in known.items():
        entries = tuple(frame.images[name] for frame in segment.frames if name in frame.images)
        times = np.array([entry.time_us for entry in entries], np.int64)
        late = np.flatnonzero(np.diff(times) <= 0)
        if len(late):
            raise entries[late[0] + 1].jpeg.error(
                "its pose is not later than that of the one before"
            )
        images = WaymoImages(entries, camera)
        streams[name] = CameraStream(name, camera, rig_from_camera, times, images)
    return streams


def shutter_notes(segment: Segment) -> Mapping[str, str]:
    """How each camera's shutter rolls, for the log's metadata: there is no other place for it.

    One entry `rolling_shutter` with JSON: by camera, the direction, and the medians over all images
    of the times at which the first and the last column (or row) read was exposed, in microseconds
    from the image's timestamp.
    """
    notes = {}
    for message in segment.context["camera_calibrations"]:
        name = message["name"]
        entries = [frame.images[name] for frame in segment.frames if name in frame.images]
        if entries:
            notes[name] = {
                "direction": message.get("rolling_shutter_direction", "unknown"),
                "first_us": round(np.median([e.first_us - e.time_us for e in entries])),
                "last_us": round(np.median([e.last_us - e.time_us for e in entries])),
            }
    return {"rolling_shutter": json.dumps(notes)} if notes else {}


def _calibration(message: Message) -> tuple[PinholeCamera, Array]:
    """Intrinsics, and (4, 4) `rig_from_camera` with OpenCV's axes."""
    intrinsic = message["intrinsic"]
    if len(intrinsic) != 9:
        raise FieldError(message.path("intrinsic"), f"has {len(intrinsic)} numbers, not 9")
    fu, fv, cu, cv, k1, k2, p1, p2, k3 = intrinsic.tolist()
    camera = PinholeCamera(
        message["width"], message["height"], fu, fv, cu, cv, (k1, k2, p1, p2, k3)
    )
    try:
        camera.validate()
    except ValueError as error:
        raise FieldError(message.where, str(error)) from None
    return camera, transform(message, "extrinsic") @ WAYMO_FROM_OPENCV
