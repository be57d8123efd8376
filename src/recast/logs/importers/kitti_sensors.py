"""KITTI velodyne sweeps and OXTS GPS/IMU packets: points when they were measured, ego poses.

The HDL-64E turns ten times a second, clockwise seen from above. A turn begins and ends facing
backwards; timestamps.txt has the moment at which it faces forward.

Source of the poses: KITTI raw development kit, readme.txt and convertOxtsToPose: Mercator
projection with the scale of the drive's first latitude; roll, pitch, yaw as R_z(yaw) R_y(pitch)
R_x(roll); x points east, z up.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path

import numpy as np
from numpy.typing import NDArray
from scipy.spatial.transform import Rotation

from recast.core import files
from recast.core.errors import InputError
from recast.geometry import se3
from recast.logs import motion
from recast.logs.checks import SENSOR_REACH
from recast.logs.importers.common import are_returns
from recast.logs.importers.kitti_files import (
    MISSING,
    SensorFiles,
    list_frames,
    read_numbers,
    read_timestamps,
)
from recast.logs.types import Array, Int64Array, LidarSweep, Trajectory

Times = int | Int64Array

POINT_BYTES = 16  # float32 x, y, z, reflectance
SWEEP_LIMIT = 1 << 26  # bytes; a turn of the scanner has 2 MB
HALF_TURN_US = 51_750  # measured on drive 2011_09_26_0013, for drives without start and end times
FIRING_US = 50  # the scanner turns 0.18 degrees in this time: about one column of points
EARTH_RADIUS = 6378137.0
FIELDS = 30
MAX_GAP_US = 1_000_000
HIGHEST = 10_000.0  # metres above the sea


@dataclass(frozen=True)
class VelodyneTurns:
    """Sweeps of one drive that exist on disk.

    Attributes:
        trigger_us, start_us, end_us: (S,) int64, facing forward, first and last firing.
        paths: S files.
    """

    trigger_us: Int64Array
    start_us: Int64Array
    end_us: Int64Array
    paths: tuple[Path, ...]

    def select(self, kept: Sequence[int]) -> VelodyneTurns:
        """The turns of these places only."""
        index = np.asarray(kept, np.intp)
        return VelodyneTurns(
            self.trigger_us[index],
            self.start_us[index],
            self.end_us[index],
            tuple(self.paths[i] for i in kept),
        )


def list_turns(folder: Path) -> VelodyneTurns:
    """List the sweeps in velodyne_points and check their sizes.

    Raises:
        InputError: no sweeps, one is cut off, or timestamps are missing or out of order.
    """
    listed = list_frames(folder, ".bin")
    check_sweep_sizes(listed.paths)
    trigger, start, end = turn_times(folder)
    index = listed.indices
    odd = np.flatnonzero(~((start < trigger) & (trigger < end))[index])
    if len(odd):
        raise InputError(
            folder / "timestamps_start.txt",
            f"line {index[odd[0]] + 1}",
            "start, trigger and end of the turn are out of order",
            "download the three timestamp files again",
        )
    return VelodyneTurns(trigger[index], start[index], end[index], listed.paths)


def turn_times(folder: Path) -> tuple[Int64Array, Int64Array, Int64Array]:
    """Trigger, start and end times (F,) of all turns of a drive, also of those without a file.

    Turns that were not recorded get times between those of their neighbours.

    Raises:
        InputError: timestamps.txt is missing, or the files disagree about the number of turns.
    """
    trigger = _filled(folder / "timestamps.txt")
    starts, ends = folder / "timestamps_start.txt", folder / "timestamps_end.txt"
    if not (starts.is_file() and ends.is_file()):
        return trigger, trigger - HALF_TURN_US, trigger + HALF_TURN_US
    start, end = _filled(starts), _filled(ends)
    for path, times in ((starts, start), (ends, end)):
        if len(times) != len(trigger):
            raise InputError(
                path,
                "lines",
                f"there are {len(times)}, but timestamps.txt has {len(trigger)}",
                "download the three timestamp files again",
            )
    return trigger, start, end


def _filled(path: Path) -> Int64Array:
    """The times (F,) of a file, missing ones interpolated.

    Raises:
        InputError: see `read_timestamps`; or fewer than two lines have a time.
    """
    times = read_timestamps(path)
    known = np.flatnonzero(times != MISSING)
    if len(known) == len(times):
        return times
    if len(known) < 2:
        raise InputError(path, "lines", "fewer than two have a time", "download the file again")
    turn = np.median(np.diff(times[known]) / np.diff(known))
    frames = np.arange(len(times))
    outside = np.minimum(frames - known[0], 0) + np.maximum(frames - known[-1], 0)
    between = np.interp(frames, known, times[known]) + outside * turn
    return np.where(times == MISSING, np.rint(between).astype(np.int64), times)


def check_sweep_sizes(paths: Sequence[Path]) -> None:
    """Check that sweep files hold whole points.

    Raises:
        InputError: one is empty or cut off.
    """
    for path in paths:
        size = path.stat().st_size
        if size > SWEEP_LIMIT:
            problem = f"{size} bytes, {SWEEP_LIMIT} at most are one turn of the scanner"
            raise InputError(path, "points", problem, "download the file again")
        if size == 0 or size % POINT_BYTES:
            raise InputError(
                path,
                "points",
                f"{size} bytes are not a whole number of {POINT_BYTES}-byte points: truncated",
                "download the file again, or delete it to do without this sweep",
            )


def read_points(path: Path) -> NDArray[np.float32]:
    """Points (N, 4) float32: x, y, z in the velodyne frame in metres, reflectance in [0, 1].

    Those without a return are left out, see `are_returns`.

    Raises:
        InputError: cut off, or out of range.
    """
    check_sweep_sizes((path,))
    data = files.read_bytes(path, SWEEP_LIMIT)
    if kind := files.kind_of_file(data):
        raise InputError(path, "points", f"are missing: the file is {kind}", "download it again")
    points = np.frombuffer(data, np.float32).reshape(-1, 4)
    points = points[are_returns(points[:, :3])]
    if not np.all(np.abs(points[:, :3]) < SENSOR_REACH):
        problem = f"lie farther than {SENSOR_REACH:g} m"
        raise InputError(path, "points", problem, "download the file again")
    if not np.all((points[:, 3] >= 0) & (points[:, 3] <= 1)):
        raise InputError(path, "reflectance", "is not within [0, 1]", "download the file again")
    return points


def firing_times(
    points: NDArray[np.floating], trigger_us: Times, start_us: Times, end_us: Times
) -> Int64Array:
    """When points (N, >=2) of the velodyne frame were measured, (N,) microseconds.

    A point at azimuth a (counter-clockwise from forward) was measured a / 2 pi of a turn before
    the scanner faced forward. Rounded to one firing, and within the turn.

    Args:
        points: metres, velodyne frame, not compensated.
        trigger_us, start_us, end_us: trigger, start and end time of the turn, or (N,) times of each
            point's turn.
    """
    turn = np.asarray(end_us - start_us, np.float64)
    azimuth = np.arctan2(points[:, 1], points[:, 0]).astype(np.float64)
    offset = np.rint(-azimuth / (2 * np.pi) * turn / FIRING_US).astype(np.int64) * FIRING_US
    return np.clip(trigger_us + offset, start_us, end_us)


@dataclass(frozen=True)
class VelodyneSweeps:
    """Sweeps read from .bin files on demand, motion-compensated; a `SweepSource`."""

    turns: VelodyneTurns
    rig_from_velodyne: Array
    world_from_rig: Trajectory

    def __len__(self) -> int:
        """Number of sweeps."""
        return len(self.turns.paths)

    def __getitem__(self, index: int) -> LidarSweep:
        """Decode sweep `index`."""
        turns = self.turns
        trigger = int(turns.trigger_us[index])
        raw = read_points(turns.paths[index])
        times = firing_times(raw, trigger, int(turns.start_us[index]), int(turns.end_us[index]))
        points = motion.compensate(
            se3.apply(self.rig_from_velodyne, raw[:, :3]), times, self.world_from_rig, trigger
        )
        return LidarSweep(trigger, points.astype(np.float32), raw[:, 3].copy(), times)


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
                path,
                "fields",
                f"there are {len(values)} of {FIELDS} numbers",
                "download the file again",
            )
        if not np.all(np.isfinite(values)):
            raise InputError(path, "fields", "hold NaN or infinity", "download it again")
        latitude, longitude, altitude = values[:3]
        if abs(latitude) > 89 or abs(longitude) > 180 or abs(altitude) > HIGHEST:
            problem = f"{latitude} {longitude} {altitude} is not a position on a road"
            raise InputError(path, "latitude, longitude, altitude", problem, "download it again")
        packets.append(values[:FIELDS])
    gaps = np.diff(files.timestamps_us)
    if len(gaps) == 0:
        raise InputError(
            files.paths[0].parent, "packets", "there is only one", "download the whole drive"
        )
    if gaps.max() > MAX_GAP_US:
        where = int(np.argmax(gaps))
        raise InputError(
            files.paths[where + 1],
            "packets before it",
            f"are missing for {gaps[where] / 1e6:.1f} s, so the poses there are unknown",
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
