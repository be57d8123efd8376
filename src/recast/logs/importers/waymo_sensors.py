"""Waymo cameras and LiDARs: images with their rolling shutter, range images as sweeps.

A range image has a row for each beam and a column for each direction of the turn, seen in the
vehicle frame: column 0 looks backwards, the middle one forwards, and the scanner turns clockwise
seen from above. The TOP LiDAR comes with the vehicle's pose at each pixel; the ego motion of the
others' turns is not known, and not undone.
"""

from __future__ import annotations

import json
from collections.abc import Iterator, Mapping
from contextlib import contextmanager
from dataclasses import dataclass

import numpy as np
from scipy.spatial.transform import Rotation

from recast.cameras import PinholeCamera
from recast.core.errors import InputError
from recast.geometry import se3
from recast.logs import checks
from recast.logs.images import decode, require_size, size_of, stored
from recast.logs.importers.common import Timed
from recast.logs.importers.waymo_proto import lidar_name
from recast.logs.importers.waymo_segment import (
    FrameEntry,
    ImageEntry,
    LaserCalibration,
    LaserEntry,
    Segment,
)
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

_SAYS = "the camera's calibration"
TURN_US = 100_000
"""Of one turn of the TOP LiDAR. Cameras fire as it sweeps past them: in the real frame the middles
of their exposures fit columns of a turn of this length, begun at the frame's time, within 1 ms."""
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
