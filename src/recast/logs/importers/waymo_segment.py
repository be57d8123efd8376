"""What is kept of a Waymo segment: the small things, and where in the file the large ones lie."""

from __future__ import annotations

from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from recast.errors import InputError
from recast.logs.importers.waymo_wire import FieldError, Message
from recast.logs.types import Array

MEND = "download it again"


@dataclass(frozen=True)
class FilePart:
    """Bytes of a file, read when asked for.

    Attributes:
        record: number of the record they belong to.
        field: their name in the record.
        offset, size: in bytes.
    """

    path: Path
    record: int
    field: str
    offset: int
    size: int

    def read(self) -> bytes:
        """The bytes."""
        with self.path.open("rb") as file:
            file.seek(self.offset)
            return file.read(self.size)

    def error(self, problem: str, mend: str = MEND) -> InputError:
        """An error that names file, record and field."""
        return InputError(self.path, f"record {self.record}, {self.field}", problem, mend)


@dataclass(frozen=True)
class ImageEntry:
    """One image.

    Attributes:
        jpeg: its file, as it was encoded.
        pose: (4, 4) `global_from_vehicle` at `time_us`.
        time_us: of the pose, about when the middle column was exposed.
        first_us, last_us: middle of the exposure of the first and last column (or row) read.
    """

    jpeg: FilePart
    pose: Array
    time_us: int
    first_us: int
    last_us: int


@dataclass(frozen=True)
class LaserEntry:
    """The range images of one LiDAR in one frame, zlib streams.

    Attributes:
        returns: first and, where there is one, second return.
        pixel_poses: of the first return's pixels, or None.
    """

    returns: tuple[FilePart, ...]
    pixel_poses: FilePart | None


@dataclass(frozen=True)
class LabelEntry:
    """One box: (4, 4) `vehicle_from_box`, size (3,) length, width, height in metres."""

    label_id: str
    category: str
    vehicle_from_box: Array
    size: Array


@dataclass(frozen=True)
class FrameEntry:
    """One frame.

    Attributes:
        record: its number in the file.
        start_us: when the first column of the TOP LiDAR was scanned.
        pose: (4, 4) `global_from_vehicle`, about the middle of the frame; labels and points are in
            this vehicle frame.
        images, lasers: by name.
    """

    record: int
    start_us: int
    pose: Array
    images: dict[str, ImageEntry]
    lasers: dict[str, LaserEntry]
    labels: tuple[LabelEntry, ...]


@dataclass(frozen=True)
class Segment:
    """A whole segment.

    Attributes:
        context: of the first frame: name, calibrations, statistics.
        map_features: of the first frame that has some; empty where none does.
        map_record: number of that frame's record.
        map_offset: (3,) map coordinates = vehicle coordinates + this.
    """

    path: Path
    context: Message
    frames: tuple[FrameEntry, ...]
    map_features: tuple[Message, ...]
    map_record: int
    map_offset: Array


@contextmanager
def record_errors(path: Path, record: int) -> Iterator[None]:
    """Turn a FieldError into the InputError that also names file and record."""
    try:
        yield
    except FieldError as error:
        field = f"record {record}, {error.field}"
        raise InputError(path, field, error.problem, MEND) from None


def transform(message: Message, name: str) -> Array:
    """The (4, 4) pose in the field `name`.

    Raises:
        FieldError: missing, not 16 numbers, or no rotation and translation.
    """
    values = message[name]["transform"]
    where = f"{message.path(name)}.transform"
    if len(values) != 16:
        raise FieldError(where, f"has {len(values)} numbers, not 16")
    pose: Array = values.reshape(4, 4).astype(np.float64)
    rotation = pose[:3, :3]
    if not np.allclose(rotation @ rotation.T, np.eye(3), atol=1e-5):  # also where one is not finite
        raise FieldError(where, "is no rotation and translation")
    return pose
