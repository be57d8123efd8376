"""What is kept of a Waymo segment, and its cameras and LiDARs, read from where they lie in it.

Both versions of the dataset, TFRecords and parquet, are read into this.

A range image has a row for each beam and a column for each direction of the turn, seen in the
vehicle frame: column 0 looks backwards, the middle one forwards, and the scanner turns clockwise
seen from above. The TOP LiDAR comes with the vehicle's pose at each pixel; the ego motion of the
others' turns is not known, and not undone.
"""

from __future__ import annotations

import json
import math
from collections.abc import Iterator, Mapping, Sequence
from contextlib import contextmanager
from dataclasses import dataclass
from pathlib import Path
from typing import Protocol

import numpy as np
from numpy.typing import ArrayLike
from scipy.spatial.transform import Rotation

from recast.cameras import PinholeCamera
from recast.core.errors import InputError
from recast.geometry import se3
from recast.logs import checks
from recast.logs.images import decode, require_size, size_of, stored
from recast.logs.importers.common import Timed
from recast.logs.importers.waymo_proto import FieldError, Message, lidar_name
from recast.logs.types import (
    Array,
    CameraStream,
    Float32Array,
    Image,
    Int64Array,
    LidarStream,
    LidarSweep,
    Trajectory,
)

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
"""Microseconds of an image from the start of its frame's turn (in the real frame 22 to 72 ms):
within reach of the ego trajectory, which goes through the images and is continued by 0.15 s."""


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


_SAYS = "the camera's calibration"
TURN_US = 100_000
"""Microseconds of one turn of the TOP LiDAR. Cameras fire as it sweeps past them: in the real frame
the middles of their exposures fit columns of a turn of this length, begun at the frame's time,
within 1 ms."""
_CHANNELS = 4  # range, intensity, elongation, in no-label zone
_POSE_CHANNELS = 6  # roll, pitch, yaw, x, y, z


@dataclass(frozen=True)
class WaymoImages:
    """The images of one camera of a segment; an `EncodedImageSource`."""

    entries: tuple[ImageEntry, ...]  # images in the order of time
    camera: PinholeCamera  # intrinsics, which tell the size that every image must have

    def __len__(self) -> int:
        """Number of frames."""
        return len(self.entries)

    def __getitem__(self, index: int) -> Image:
        """Decode frame `index` to (height, width, 3) uint8 RGB."""
        return self._decode(index, self.entries[index].jpeg.read())

    def encoded(self, index: int) -> tuple[bytes, str]:
        """What `stored` makes of the JPEG, decoded once if no checksum vouches for it. Raises
        InputError: it is no JPEG, or of another size than the calibration says."""
        jpeg = self.entries[index].jpeg
        data = jpeg.read()
        if not jpeg.sealed:
            self._decode(index, data)
        with self._errors(index):
            require_size(size_of(data, "jpeg", ""), self._size, "", _SAYS)
            return stored(data, "jpeg", "")

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
            raise self.entries[index].jpeg.place.error(error.problem) from None


def read_cameras(segment: Segment) -> dict[str, CameraStream]:
    """The cameras of a segment by name; those without images keep their calibration. Raises
    InputError: a calibration is missing, or images of a camera are out of order."""
    for frame in segment.frames:
        for name, image in frame.images.items():
            if name not in segment.cameras:
                raise image.jpeg.place.error(f"there is no calibration of camera {name}")
    streams = {}
    for name, known in sorted(segment.cameras.items()):
        entries = tuple(frame.images[name] for frame in segment.frames if name in frame.images)
        times = np.array([entry.time_us for entry in entries], np.int64)
        late = np.flatnonzero(np.diff(times) <= 0)
        if len(late):
            raise entries[late[0] + 1].jpeg.place.error(
                "its pose is not later than the pose of the image before"
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


def beams(calibration: LaserCalibration, rows: int) -> Array:
    """Inclinations (rows,) of the rows of a range image, the highest first. Raises ValueError:
    there are as many beams as rows in no way."""
    listed = calibration.inclinations
    if len(listed):
        if len(listed) != rows:
            raise ValueError(f"has {rows} rows, but {len(listed)} beam inclinations")
        return listed[::-1]
    share = (np.arange(rows)[::-1] + 0.5) / rows
    return calibration.lowest + share * (calibration.highest - calibration.lowest)


def azimuths(columns: int) -> Array:
    """Directions (columns,) in the vehicle frame of a range image's columns, radians."""
    share = (columns - np.arange(columns) - 0.5) / columns
    return (2 * share - 1) * np.pi


def scan_times(azimuth: Array, start_us: int) -> Int64Array:
    """When the TOP LiDAR points in a direction (N,) of the vehicle frame, turning from `start_us`.

    Azimuth pi is looked at first, -pi last.
    """
    share = (np.pi - np.asarray(azimuth)) / (2 * np.pi)
    return start_us + np.rint(share * TURN_US).astype(np.int64)


def range_image_points(
    image: Float32Array, calibration: LaserCalibration, pixel_poses: Float32Array | None
) -> tuple[Array, Int64Array, Int64Array]:
    """Points of the pixels that have a range.

    Args:
        image: (H, W, C) with ranges in metres first; 0 or less where nothing returned.
        calibration: calibration of this LiDAR.
        pixel_poses: (H, W, 6) roll, pitch, yaw (applied in this order about fixed axes) and place
            of the vehicle in the global frame at each pixel; None where not known.

    Returns:
        points (N, 3) float64 in the global frame if `pixel_poses` are given, else in the vehicle
        frame; rows (N,) and columns (N,) of their pixels, row by row.

    Raises:
        ValueError: beams do not fit the rows, or a range is no LiDAR's.
    """
    height, width = image.shape[:2]
    if (farthest := float(image[..., 0].max())) > checks.SENSOR_REACH:
        raise ValueError(f"holds a range of {farthest:g} m")
    rows, columns = np.nonzero(image[..., 0] > 0)
    mount = calibration.rig_from_lidar
    azimuth = azimuths(width)[columns] - np.arctan2(mount[1, 0], mount[0, 0])
    inclination = beams(calibration, height)[rows]
    distance = image[rows, columns, 0].astype(np.float64)
    level = distance * np.cos(inclination)
    in_lidar = np.stack(
        [level * np.cos(azimuth), level * np.sin(azimuth), distance * np.sin(inclination)], axis=-1
    )
    points = se3.apply(mount, in_lidar)
    if pixel_poses is not None:
        pose = pixel_poses[rows, columns].astype(np.float64)
        points = Rotation.from_euler("xyz", pose[:, :3]).apply(points) + pose[:, 3:]
    return points, rows, columns


@dataclass(frozen=True)
class WaymoSweeps(Timed):
    """The sweeps of one LiDAR of a segment, both returns, read on demand."""

    name: str  # name of the LiDAR
    frames: tuple[FrameEntry, ...]  # frames that have this LiDAR
    timestamps_us: Int64Array  # (S,) times of the sweeps in microseconds
    calibration: LaserCalibration  # calibration of this LiDAR
    # (S, 4, 4) transforms from the frame's vehicle frame to the rig's at the sweep's time.
    rig_from_vehicle: Array

    def __getitem__(self, index: int) -> LidarSweep:
        """Decode sweep `index`: first returns, then second ones. Raises InputError: a range image
        is damaged, empty, or does not fit the calibration."""
        frame = self.frames[index]
        laser = frame.lasers[self.name]
        images = [part.read(_CHANNELS) for part in laser.returns]
        poses = _pixel_poses(laser, images[0].shape[:2])
        points, intensities, columns = [], [], []
        for part, image in zip(laser.returns, images, strict=True):
            if image.shape != images[0].shape:
                raise part.place.error(
                    f"is {image.shape}, but the first return is {images[0].shape}"
                )
            try:
                placed, row, column = range_image_points(image, self.calibration, poses)
            except ValueError as error:
                raise part.place.error(str(error)) from None
            points.append(placed)
            # The sensor's scale is open above; most surfaces are below 1.
            intensities.append(np.tanh(np.maximum(image[row, column, 1], 0.0)))
            columns.append(column)
        in_vehicle = np.concatenate(points)
        times = None
        if poses is not None:
            in_vehicle = se3.apply(se3.inverse(frame.pose), in_vehicle)
            directions = azimuths(images[0].shape[1])[np.concatenate(columns)]
            times = scan_times(directions, frame.start_us)
        return LidarSweep(
            int(self.timestamps_us[index]),
            se3.apply(self.rig_from_vehicle[index], in_vehicle).astype(np.float32),
            np.concatenate(intensities).astype(np.float32),
            times,
        )


def read_lidars(
    segment: Segment, frame_times_us: Int64Array, world_from_global: Array, trajectory: Trajectory
) -> dict[str, LidarStream]:
    """The LiDARs of a segment by `lidar_name`; none where its range images have been taken out.

    Args:
        segment: frames and calibration.
        frame_times_us: (F,) time at which points and labels of each frame are taken to hold.
        world_from_global: (4, 4).
        trajectory: trajectory of the rig in the world.

    Raises:
        InputError: a calibration is missing, or a LiDAR has no range image in some frames.
    """
    names = sorted({name for frame in segment.frames for name in frame.lasers})
    for frame in segment.frames:
        for name in names:
            if name not in frame.lasers:
                raise frame.place.inside(f"LiDAR {name}").error("its range image is missing")
            if name not in segment.lasers:
                raise (
                    frame.lasers[name]
                    .returns[0]
                    .place.error(f"there is no calibration of LiDAR {name}")
                )
    world_from_vehicle = world_from_global @ np.stack([frame.pose for frame in segment.frames])
    rig_from_vehicle = se3.inverse(trajectory.at(frame_times_us)) @ world_from_vehicle
    streams = {}
    for name in names:
        calibration = segment.lasers[name]
        sweeps = WaymoSweeps(name, segment.frames, frame_times_us, calibration, rig_from_vehicle)
        stream = lidar_name(name)
        streams[stream] = LidarStream(stream, calibration.rig_from_lidar, frame_times_us, sweeps)
    return streams


def _pixel_poses(laser: LaserEntry, shape: tuple[int, ...]) -> Float32Array | None:
    if laser.pixel_poses is None:
        return None
    poses = laser.pixel_poses.read(_POSE_CHANNELS)
    if not np.all(np.abs(poses) <= checks.WORLD_REACH):
        raise laser.pixel_poses.place.error(f"holds a pose not within {checks.WORLD_REACH:g} m")
    if poses.shape[:2] != shape:
        raise laser.pixel_poses.place.error(f"is {poses.shape[:2]}, but the range image is {shape}")
    return poses
