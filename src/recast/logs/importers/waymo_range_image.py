"""Waymo range images: the matrices, and the points they stand for.

A range image has a row for each beam and a column for each direction of the turn, seen in the
vehicle frame: column 0 looks backwards, the middle one forwards, and the scanner turns clockwise
seen from above.
"""

from __future__ import annotations

import zlib
from dataclasses import dataclass

import numpy as np
from scipy.spatial.transform import Rotation

from recast.geometry import se3
from recast.logs.importers.waymo_schema import MATRIX_FLOAT
from recast.logs.importers.waymo_segment import FilePart, transform
from recast.logs.importers.waymo_wire import FieldError, Message, decode
from recast.logs.types import Array, Float32Array, Int64Array

TURN_US = 100_000
"""Of one turn of the TOP LiDAR. Cameras fire as it sweeps past them: in the real frame the middles
of their exposures fit columns of a turn of this length, begun at the frame's time, within 1 ms."""
_LARGEST = 1 << 27
"""Bytes of an unpacked matrix: a stream that is longer is no range image."""


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

    def beams(self, rows: int) -> Array:
        """Inclinations (rows,) of the rows, the highest first.

        Raises:
            ValueError: there are as many beams as rows in no way.
        """
        if len(self.inclinations):
            if len(self.inclinations) != rows:
                raise ValueError(f"{rows} rows, but {len(self.inclinations)} beam inclinations")
            return self.inclinations[::-1]
        share = (np.arange(rows)[::-1] + 0.5) / rows
        spread: Array = self.lowest + share * (self.highest - self.lowest)
        return spread


def azimuths(columns: int) -> Array:
    """Directions (columns,) in the vehicle frame of a range image's columns, radians."""
    share = (columns - np.arange(columns) - 0.5) / columns
    turned: Array = (2 * share - 1) * np.pi
    return turned


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
        calibration: of this LiDAR.
        pixel_poses: (H, W, 6) roll, pitch, yaw (applied in this order about fixed axes) and place
            of the vehicle in the global frame at each pixel; None where not known.

    Returns:
        points (N, 3) float64 in the global frame if `pixel_poses` are given, else in the vehicle
        frame; rows (N,) and columns (N,) of their pixels, row by row.

    Raises:
        ValueError: beams do not fit the rows.
    """
    height, width = image.shape[:2]
    beams = calibration.beams(height)
    rows, columns = np.nonzero(image[..., 0] > 0)
    mount = calibration.rig_from_lidar
    azimuth = azimuths(width)[columns] - np.arctan2(mount[1, 0], mount[0, 0])
    inclination, distance = beams[rows], image[rows, columns, 0].astype(np.float64)
    level = distance * np.cos(inclination)
    in_lidar = np.stack(
        [level * np.cos(azimuth), level * np.sin(azimuth), distance * np.sin(inclination)], axis=-1
    )
    points = se3.apply(mount, in_lidar)
    if pixel_poses is not None:
        pose = pixel_poses[rows, columns].astype(np.float64)
        points = Rotation.from_euler("xyz", pose[:, :3]).apply(points) + pose[:, 3:]
    return points, rows, columns


def read_calibration(message: Message) -> LaserCalibration:
    """A LaserCalibration message.

    Raises:
        FieldError: a field is missing or wrong.
    """
    inclinations = message["beam_inclinations"].astype(np.float64)
    if len(inclinations):
        if not np.all(np.diff(inclinations) > 0):
            raise FieldError(message.path("beam_inclinations"), "do not ascend")
        lowest, highest = float(inclinations[0]), float(inclinations[-1])
    else:
        lowest, highest = message["beam_inclination_min"], message["beam_inclination_max"]
        if not lowest < highest:
            field = message.path("beam_inclination_max")
            raise FieldError(field, f"{highest:g} is not above the minimum {lowest:g}")
    return LaserCalibration(inclinations, lowest, highest, transform(message, "extrinsic"))


def read_matrix(part: FilePart, channels: int) -> Float32Array:
    """The (H, W, channels) float32 matrix of a zlib stream.

    Raises:
        InputError: it is empty, damaged, or of another shape.
    """
    if part.size == 0:
        raise part.error("is empty")
    try:
        stream = zlib.decompressobj()
        data = stream.decompress(part.read(), _LARGEST)
    except zlib.error as error:
        raise part.error(f"is no zlib stream ({error})") from None
    if not stream.eof:
        raise part.error("is cut off or too large")
    try:
        message = decode(MATRIX_FLOAT, data)
        values, dims = message["data"], message["shape"]["dims"]
    except FieldError as error:
        raise part.error(f"holds no matrix: {error}") from None
    if len(dims) != 3 or dims[2] != channels or min(dims) < 1 or np.prod(dims) != len(values):
        raise part.error(
            f"has dimensions {dims} for {len(values)} values, not (rows, columns, {channels})"
        )
    if not np.isfinite(values).all():
        raise part.error("holds values that are not finite")
    matrix: Float32Array = values.reshape(dims).astype(np.float32, copy=False)
    return matrix
