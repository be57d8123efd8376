"""Waymo cameras: images and their rolling shutter."""

from __future__ import annotations

import json
from collections.abc import Iterator, Mapping
from contextlib import contextmanager
from dataclasses import dataclass

import numpy as np

from recast.core.errors import InputError
from recast.geometry import PinholeCamera
from recast.logs.images import decode, require_size, size_of
from recast.logs.importers.waymo_segment import ImageEntry, Segment
from recast.logs.types import CameraStream, Image

_SAYS = "the camera's calibration"


@dataclass(frozen=True)
class WaymoImages:
    """The images of one camera of a segment; an `EncodedImageSource`.

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
        return self._decode(index, self.entries[index].jpeg.read())

    def encoded(self, index: int) -> tuple[bytes, str]:
        """The JPEG file as it is in the dataset, decoded once if no checksum vouches for it.

        Raises:
            InputError: it is no JPEG, or of another size than the calibration says.
        """
        jpeg = self.entries[index].jpeg
        data = jpeg.read()
        if not jpeg.sealed:
            self._decode(index, data)
            return data, "jpeg"
        with self._errors(index):
            require_size(size_of(data, "jpeg", ""), self._size, "", _SAYS)
        return data, "jpeg"

    @property
    def _size(self) -> tuple[int, int]:
        return self.camera.width, self.camera.height

    def _decode(self, index: int, data: bytes) -> Image:
        with self._errors(index):
            return decode(data, "jpeg", self._size, "", _SAYS)

    @contextmanager
    def _errors(self, index: int) -> Iterator[None]:
        try:
            yield
        except InputError as error:
            raise self.entries[index].jpeg.error(error.problem) from None


def read_cameras(segment: Segment) -> dict[str, CameraStream]:
    """The cameras of a segment by name; those without images keep their calibration.

    Raises:
        InputError: a calibration is missing, or images of a camera are out of order.
    """
    for frame in segment.frames:
        for name, image in frame.images.items():
            if name not in segment.cameras:
                raise image.jpeg.error(f"there is no calibration of camera {name}")
    streams = {}
    for name, known in sorted(segment.cameras.items()):
        entries = tuple(frame.images[name] for frame in segment.frames if name in frame.images)
        times = np.array([entry.time_us for entry in entries], np.int64)
        late = np.flatnonzero(np.diff(times) <= 0)
        if len(late):
            raise entries[late[0] + 1].jpeg.error(
                "its pose is not later than that of the one before"
            )
        images = WaymoImages(entries, known.camera)
        streams[name] = CameraStream(name, known.camera, known.rig_from_camera, times, images)
    return streams


def shutter_notes(segment: Segment) -> Mapping[str, str]:
    """How each camera's shutter rolls, for the log's metadata: there is no other place for it.

    One entry `rolling_shutter` with JSON: by camera, the direction, and the medians over all images
    of the times at which the first and the last column (or row) read was exposed, in microseconds
    from the image's timestamp.
    """
    notes = {}
    for name, known in sorted(segment.cameras.items()):
        entries = [frame.images[name] for frame in segment.frames if name in frame.images]
        if entries:
            notes[name] = {
                "direction": known.shutter,
                "first_us": round(np.median([e.first_us - e.time_us for e in entries])),
                "last_us": round(np.median([e.last_us - e.time_us for e in entries])),
            }
    return {"rolling_shutter": json.dumps(notes)} if notes else {}
