"""Waymo range images and the points they stand for.

A range image has a row for each beam and a column for each direction of the turn, seen in the
vehicle frame: column 0 looks backwards, the middle one forwards, and the scanner turns clockwise
seen from above.
"""

from __future__ import annotations

import numpy as np
from scipy.spatial.transform import Rotation

from recast.geometry import se3
from recast.logs import checks
from recast.logs.importers.waymo_segment import LaserCalibration
from recast.logs.types import Array, Float32Array, Int64Array

TURN_US = 100_000
"""Of one turn of the TOP LiDAR. Cameras fire as it sweeps past them: in the real frame the middles
of their exposures fit columns of a turn of this length, begun at the frame's time, within 1 ms."""


def beams(calibration: LaserCalibration, rows: int) -> Array:
    """Inclinations (rows,) of the rows of a range image, the highest first.

    Raises:
        ValueError: there are as many beams as rows in no way.
    """
    listed = calibration.inclinations
    if len(listed):
        if len(listed) != rows:
            raise ValueError(f"{rows} rows, but {len(listed)} beam inclinations")
        return listed[::-1]
    share = (np.arange(rows)[::-1] + 0.5) / rows
    spread: Array = calibration.lowest + share * (calibration.highest - calibration.lowest)
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
