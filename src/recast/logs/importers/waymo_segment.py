"""What is kept of a Waymo segment: the small things, and where in its files the large ones lie.

Both versions of the dataset, TFRecords and parquet, are read into this.
"""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from contextlib import contextmanager
from dataclasses import dataclass
from pathlib import Path
from typing import Protocol

from recast.cameras import PinholeCamera
from recast.core.errors import InputError
from recast.logs.importers.waymo_proto import FieldError, Message
from recast.logs.types import Array, Float32Array

MEND = "download it again"


@dataclass(frozen=True)
class Place:
    """Where something is written, for messages: the file, and what to look for in it."""

    path: Path
    field: str

    def inside(self, field: str) -> Place:
        """A field of what lies here."""
        return Place(self.path, f"{self.field}, {field}")

    def error(self, problem: str, mend: str = MEND) -> InputError:
        """An error that names this place."""
        return InputError(self.path, self.field, problem, mend)

    @contextmanager
    def errors(self) -> Iterator[None]:
        """Turn a FieldError into the InputError that also names this place."""
        try:
            yield
        except FieldError as error:
            raise self.inside(error.field).error(error.problem) from None


@contextmanager
def record_errors(path: Path, record: int) -> Iterator[None]:
    """Turn a FieldError into the InputError that also names file and record."""
    with Place(path, f"record {record}").errors():
        yield


class StoredBytes(Protocol):
    """Bytes in a file, read when asked for."""

    @property
    def place(self) -> Place:
        """Where they are written."""

    @property
    def sealed(self) -> bool:
        """Whether a checksum of theirs has been compared."""

    def read(self) -> bytes:
        """The bytes; raises InputError where they are damaged or missing."""


class StoredMatrix(Protocol):
    """A range image in a file, read when asked for."""

    @property
    def place(self) -> Place:
        """Where it is written."""

    def read(self, channels: int) -> Float32Array:
        """The (H, W, channels) matrix; raises InputError where it is empty, damaged or another."""


@dataclass(frozen=True)
class WaymoCamera:
    """One camera.

    Attributes:
        camera: intrinsics, with the lens distortion.
        rig_from_camera: (4, 4) pose of the OpenCV camera frame.
        shutter: the direction in which the rolling shutter reads, as CAMERA calibrations name it.
    """

    camera: PinholeCamera
    rig_from_camera: Array
    shutter: str


@dataclass(frozen=True)
class LaserCalibration:
    """One LiDAR.

    Attributes:
        inclinations: (B,) radians, ascending, of each beam; empty where they are evenly spread.
        lowest, highest: radians, ends of the field of view where evenly spread.
        rig_from_lidar: (4, 4).
    """

    inclinations: Array
    lowest: float
    highest: float
    rig_from_lidar: Array


@dataclass(frozen=True)
class ImageEntry:
    """One image.

    Attributes:
        jpeg: its file, as it was encoded.
        pose: (4, 4) `global_from_vehicle` at `time_us`.
        time_us: time of the pose, about when the middle column was exposed.
        first_us, last_us: middle of the exposure of the first and last column (or row) read.
    """

    jpeg: StoredBytes
    pose: Array
    time_us: int
    first_us: int
    last_us: int


@dataclass(frozen=True)
class LaserEntry:
    """The range images of one LiDAR in one frame.

    Attributes:
        returns: first and, where there is one, second return.
        pixel_poses: vehicle poses at the first return's pixels, or None.
    """

    returns: tuple[StoredMatrix, ...]
    pixel_poses: StoredMatrix | None


@dataclass(frozen=True)
class LabelEntry:
    """One box: (4, 4) `vehicle_from_box`, size (3,) length, width, height in metres.

    `place` is where its id is written.
    """

    place: Place
    label_id: str
    category: str
    vehicle_from_box: Array
    size: Array


@dataclass(frozen=True)
class FrameEntry:
    """One frame.

    Attributes:
        place: place where the frame is written.
        start_us: time when the first column of the TOP LiDAR was scanned.
        pose: (4, 4) `global_from_vehicle`, about the middle of the frame; labels and points are in
            this vehicle frame.
        images: images by camera name.
        lasers: range images by LiDAR name.
    """

    place: Place
    start_us: int
    pose: Array
    images: Mapping[str, ImageEntry]
    lasers: Mapping[str, LaserEntry]
    labels: tuple[LabelEntry, ...]


@dataclass(frozen=True)
class MapFeatures:
    """The map features of the first frame that has some.

    Attributes:
        place: place of the frame.
        offset: (3,) map coordinates = vehicle coordinates + this.
    """

    place: Place
    features: tuple[Message, ...]
    offset: Array


@dataclass(frozen=True)
class Segment:
    """A whole segment.

    Attributes:
        cameras, lasers: calibrations by name.
        frames: frames in the order of time.
        notes: where, when and in which weather, as far as it is known.
        map: None where there is none: before v1.4.2, and in v2.
    """

    name: str
    cameras: Mapping[str, WaymoCamera]
    lasers: Mapping[str, LaserCalibration]
    frames: tuple[FrameEntry, ...]
    notes: Mapping[str, str]
    map: MapFeatures | None
