"""What is kept of a Waymo segment: the small things, and where in its files the large ones lie.

Both versions of the dataset, TFRecords and parquet, are read into this.
"""

from __future__ import annotations

import math
from collections.abc import Iterator, Mapping, Sequence
from contextlib import contextmanager
from dataclasses import dataclass
from pathlib import Path
from typing import Protocol

import numpy as np
from numpy.typing import ArrayLike

from recast.cameras import PinholeCamera
from recast.core.errors import InputError
from recast.geometry import se3
from recast.logs import checks
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
    """One camera."""

    camera: PinholeCamera  # intrinsics, with the lens distortion
    rig_from_camera: Array  # (4, 4) pose of the OpenCV camera frame
    shutter: str  # the direction in which the rolling shutter reads, as CAMERA calibrations name it


@dataclass(frozen=True)
class LaserCalibration:
    """One LiDAR."""

    inclinations: Array  # (B,) radians, ascending, of each beam; empty where they are evenly spread
    # lowest, highest: radians, ends of the field of view where evenly spread.
    lowest: float
    highest: float
    rig_from_lidar: Array  # (4, 4)


@dataclass(frozen=True)
class ImageEntry:
    """One image."""

    jpeg: StoredBytes  # its file, as it was encoded
    pose: Array  # (4, 4) `global_from_vehicle` at `time_us`
    time_us: int  # time of the pose, about when the middle column was exposed
    # first_us, last_us: middle of the exposure of the first and last column (or row) read.
    first_us: int
    last_us: int


@dataclass(frozen=True)
class LaserEntry:
    """The range images of one LiDAR in one frame."""

    returns: tuple[StoredMatrix, ...]  # first and, where there is one, second return
    pixel_poses: StoredMatrix | None  # vehicle poses at the first return's pixels, or None


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
    """One frame."""

    place: Place  # place where the frame is written
    start_us: int  # time when the first column of the TOP LiDAR was scanned
    # (4, 4) `global_from_vehicle`, about the middle of the frame; labels and points are in this
    # vehicle frame.
    pose: Array
    images: Mapping[str, ImageEntry]  # images by camera name
    lasers: Mapping[str, LaserEntry]  # range images by LiDAR name
    labels: tuple[LabelEntry, ...]


@dataclass(frozen=True)
class MapFeatures:
    """The map features of the first frame that has some."""

    place: Place  # place of the frame
    features: tuple[Message, ...]
    offset: Array  # (3,) map coordinates = vehicle coordinates + this


@dataclass(frozen=True)
class Segment:
    """A whole segment."""

    name: str
    # cameras, lasers: calibrations by name.
    cameras: Mapping[str, WaymoCamera]
    lasers: Mapping[str, LaserCalibration]
    frames: tuple[FrameEntry, ...]  # frames in the order of time
    notes: Mapping[str, str]  # where, when and in which weather, as far as it is known
    map: MapFeatures | None  # None where there is none: before v1.4.2, and in v2


# Values of the Waymo dataset, checked; each version of the dataset has its own names for them.
#
# `where` and `field` are those names, for the errors.

WAYMO_FROM_OPENCV = se3.from_rotation_translation(
    np.array([[0.0, 0.0, 1.0], [-1.0, 0.0, 0.0], [0.0, -1.0, 0.0]]), np.zeros(3)
)
"""Waymo's camera frame is x forward, y left, z up."""
_EARLIEST_US, _LATEST_US = -50_000, 150_000
"""Of an image from the start of its frame's turn (in the real frame 22 to 72 ms): within reach of
the ego trajectory, which goes through the images and is continued by 0.15 s."""


def rigid(values: Array, where: str) -> Array:
    """Sixteen numbers, row by row, as a (4, 4) pose. Raises FieldError: they are not 16 numbers, or
    no rotation and translation."""
    if len(values) != 16:
        raise FieldError(where, f"has {len(values)} numbers, not 16")
    pose: Array = values.reshape(4, 4).astype(np.float64)
    try:
        checks.check_poses(where, pose, checks.WORLD_REACH)
    except ValueError:
        raise FieldError(where, "is not a rotation and translation") from None
    return pose


def frame_time(time_us: int, where: str) -> int:
    """The time of a frame in microseconds. Raises FieldError: no log can hold it."""
    if not 0 <= time_us < checks.LATEST_US:
        raise FieldError(where, f"{time_us} is not a time in microseconds since 1970")
    return time_us


def camera_calibration(
    where: str, size: tuple[int, int], intrinsic: Sequence[float], extrinsic: Array, shutter: str
) -> WaymoCamera:
    """A camera of (width, height), with fu, fv, cu, cv, k1, k2, p1, p2, k3.

    Its distortion is OpenCV's, on u = -y / x and v = -z / x. Pixel coordinates are continuous, 0 at
    the left edge of the first pixel: as ours.

    Raises:
        FieldError: this is no camera.
    """
    fu, fv, cu, cv, k1, k2, p1, p2, k3 = intrinsic
    camera = PinholeCamera(*size, fu, fv, cu, cv, (k1, k2, p1, p2, k3))
    try:
        camera.validate()
    except ValueError as error:
        raise FieldError(where, str(error)) from None
    return WaymoCamera(camera, extrinsic @ WAYMO_FROM_OPENCV, shutter)


def laser_calibration(
    inclinations: tuple[str, Array], ends: Mapping[str, float], extrinsic: Array
) -> LaserCalibration:
    """A LiDAR.

    Args:
        inclinations: field and radians (B,), ascending; none where evenly spread.
        ends: lowest and highest inclination in radians, by field; none needed where not evenly
            spread.
        extrinsic: (4, 4).

    Raises:
        FieldError: inclinations do not increase, or one is not an angle.
    """
    field, values = inclinations
    if len(values):
        if not np.all(np.diff(values) > 0):
            raise FieldError(field, "must increase")
        if not np.all(np.abs(values) <= np.pi):
            raise FieldError(field, "are not all within pi radians")
        return LaserCalibration(values, float(values[0]), float(values[-1]), extrinsic)
    (_, lowest), (field, highest) = ends.items()
    if not -np.pi <= lowest < highest <= np.pi:
        problem = f"{highest:g} is not above the minimum {lowest:g}, or not an angle"
        raise FieldError(field, problem)
    return LaserCalibration(values, lowest, highest, extrinsic)


def image_entry(
    jpeg: StoredBytes, pose: Array, seconds: Mapping[str, float], start_us: int
) -> ImageEntry:
    """An image of the frame that begins at `start_us`.

    Args:
        jpeg: its file.
        pose: (4, 4) `global_from_vehicle` when it was taken.
        seconds: values in seconds by field: the time of the pose, the duration of the exposure, the
            time when the camera was triggered and the time when it was read out.
        start_us: start time of the frame.

    Raises:
        FieldError: a time is none, or far from the frame's.
    """
    for field, value in seconds.items():
        if not abs(value) <= checks.LATEST_US / 1e6:  # also NaN
            raise FieldError(field, f"is {value}, not a valid time")
    stamp, exposure, trigger, done = seconds.values()
    time_us = round(stamp * 1e6)
    if not _EARLIEST_US <= time_us - start_us <= _LATEST_US:
        problem = f"is {(time_us - start_us) / 1e6:g} s after the time of the frame"
        raise FieldError(next(iter(seconds)), problem)
    first, last = trigger + exposure / 2, done - exposure / 2
    return ImageEntry(jpeg, pose, time_us, round(first * 1e6), round(last * 1e6))


def label_entry(place: Place, label_id: str, category: str, box: Mapping[str, float]) -> LabelEntry:
    """A label whose `box` has, by field, centre x, y, z, length, width, height and heading. Raises
    FieldError: a number is none, a place is too far away, or a size is not positive or too
    large."""
    shortest, longest = checks.BOX_SIDE
    for i, (field, value) in enumerate(box.items()):
        is_size = 3 <= i < 6
        fits = shortest <= value <= longest if is_size else abs(value) <= checks.SENSOR_REACH
        if not fits:  # also NaN
            raise FieldError(field, f"is {value:g}, which is out of range")
    values = np.array(list(box.values()), np.float64)
    return LabelEntry(place, label_id, category, placed_box(values[:3], values[6]), values[3:6])


def placed_box(centre: Array, heading: float) -> Array:
    """Pose (4, 4) of a level box."""
    return se3.from_rotation_translation(se3.rotation_z(heading), centre)


def shaped(values: ArrayLike, dims: Sequence[int], channels: int) -> Float32Array:
    """The (H, W, channels) float32 matrix of numbers in a row. Raises ValueError: there are not as
    many, the shape is another, or one is not finite."""
    with np.errstate(over="ignore"):  # what becomes infinite is refused below
        numbers = np.asarray(values, np.float32)
    if len(dims) != 3 or dims[2] != channels or min(dims) < 1 or math.prod(dims) != len(numbers):
        raise ValueError(
            f"has dimensions {list(dims)} for {len(numbers)} values, "
            f"not (rows, columns, {channels})"
        )
    if not np.isfinite(numbers).all():
        raise ValueError("holds values that are not finite")
    return numbers.reshape(dims)
