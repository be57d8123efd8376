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
from recast.logs.types import Array, Int64Array, Trajectory

EARTH_RADIUS = 6378137.0
FIELDS = 30
MAX_EXTENSION_US = 150_000
MAX_GAP_US = 1_000_000


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
        if not np.all(np.isfinite(values)) or abs(values[0]) > 89:
            raise InputError(path, "latitude", f"{values[0]} is no place", "download it again")
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


def extended(trajectory: Trajectory, first_us: int, last_us: int) -> Trajectory:
    """Lengthen a trajectory to cover [first_us, last_us], by at most 0.15 s at either end.

    Sensors start and stop within a cycle of each other, so the first image may come before the
    first packet. The motion of the first (last) interval is continued with a constant twist.
    """
    times, poses = trajectory.timestamps_us, trajectory.poses
    first = max(first_us, int(times[0]) - MAX_EXTENSION_US)
    last = min(last_us, int(times[-1]) + MAX_EXTENSION_US)
    new_times: Int64Array = times
    new_poses = poses
    if first < times[0]:
        start = _continued(poses[1], poses[0], times[0] - times[1], first - times[0])
        new_times = np.concatenate([[first], new_times])
        new_poses = np.concatenate([start[None], new_poses])
    if last > times[-1]:
        end = _continued(poses[-2], poses[-1], times[-1] - times[-2], last - times[-1])
        new_times = np.concatenate([new_times, [last]])
        new_poses = np.concatenate([new_poses, end[None]])
    return Trajectory(new_times.astype(np.int64), new_poses)


def _continued(before: Array, at: Array, interval_us: int, ahead_us: int) -> Array:
    twist = se3.log(se3.inverse(before) @ at)
    moved: Array = at @ se3.exp(twist * (ahead_us / interval_us))
    return moved
