"""OXTS GPS/IMU packets to ego poses.

Source: KITTI raw development kit, readme.txt and convertOxtsToPose: Mercator projection with the
scale of the drive's first latitude; roll, pitch, yaw as R_z(yaw) R_y(pitch) R_x(roll); x points
east, z up.
"""

from __future__ import annotations

import numpy as np
from scipy.spatial.transform import Rotation

from recast.errors import InputError
from recast.geometry import se3
from recast.logs.importers.kitti_files import SensorFiles, read_numbers
from recast.logs.types import Array

EARTH_RADIUS = 6378137.0
FIELDS = 30
MAX_GAP_US = 1_000_000
HIGHEST = 10_000.0  # metres above the sea


def read_oxts(files: SensorFiles) -> Array:
    """Packets (F, 30): latitude, longitude, altitude, roll, pitch, yaw, velocities and more.

    Raises:
        InputError: a packet has too few fields, is not finite, or the frames have a gap over 1 s.
    """
    packets = []
    for path in files.paths:
        values = read_numbers(path)
        if len(values) < FIELDS:
            raise InputError(
                path, "fields", f"{len(values)} of {FIELDS} numbers", "download the file again"
            )
        if not np.all(np.isfinite(values)):
            raise InputError(path, "fields", "hold NaN or infinity", "download it again")
        latitude, longitude, altitude = values[:3]
        if abs(latitude) > 89 or abs(longitude) > 180 or abs(altitude) > HIGHEST:
            problem = f"{latitude} {longitude} {altitude} is no place on a road"
            raise InputError(path, "latitude, longitude, altitude", problem, "download it again")
        packets.append(values[:FIELDS])
    gaps = np.diff(files.timestamps_us)
    if len(gaps) == 0:
        raise InputError(files.paths[0].parent, "packets", "only one", "download the whole drive")
    if gaps.max() > MAX_GAP_US:
        where = int(np.argmax(gaps))
        raise InputError(
            files.paths[where + 1],
            "packets before it",
            f"are missing for {gaps[where] / 1e6:.1f} s, poses would be guesses",
            "download the missing oxts files",
        )
    return np.array(packets)


def poses_from_oxts(packets: Array) -> Array:
    """Poses (F, 4, 4) `enu_from_imu`, metres, east-north-up, of packets (F, >=6)."""
    latitude, longitude, altitude = packets[:, :3].T
    scale = np.cos(np.radians(latitude[0]))
    east = scale * EARTH_RADIUS * np.radians(longitude)
    north = scale * EARTH_RADIUS * np.log(np.tan(np.pi / 4 + np.radians(latitude) / 2))
    rotation = Rotation.from_euler("ZYX", packets[:, [5, 4, 3]]).as_matrix()
    return se3.from_rotation_translation(rotation, np.stack([east, north, altitude], axis=-1))
