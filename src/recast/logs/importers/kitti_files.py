"""Files of one KITTI raw drive: names, timestamps, calibration and the mounting of the sensors.

Source: Geiger et al., "Vision meets Robotics: The KITTI Dataset" (IJRR 2013), section 3, figure 3.
"""

from __future__ import annotations

import re
from collections.abc import Sequence
from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np
from numpy.typing import NDArray
from scipy.spatial.transform import Rotation

from recast.cameras import PinholeCamera
from recast.core import files
from recast.core.errors import InputError
from recast.geometry import se3
from recast.logs import motion
from recast.logs.checks import SENSOR_REACH, check_reach, refused
from recast.logs.importers.common import (
    are_returns,
    files_of,
    nearest_rotation,
    unknown_drive,
    words_of,
)
from recast.logs.types import Array, Int64Array, LidarSweep, Trajectory

TEXT_LIMIT = 1 << 26
"""Bytes of a text file; labels of a long drive have 1 MB."""
MISSING = -1
"""Time of a frame that was not recorded."""
_FRAME = re.compile(r"[0-9]{1,10}")
_TIME = re.compile(
    r"(19[7-9][0-9]|2[01][0-9]{2})-[0-9]{2}-[0-9]{2}[ T]"  # nanoseconds end in the year 2262
    r"[0-9]{2}:[0-9]{2}:[0-9]{2}(\.[0-9]{1,9})?"
)
# The GPS/IMU sits 0.93 m above the ground, 0.05 m behind the rear axle and 0.32 m left of the
# velodyne, which stands on the car's centre line (figure 3, and T of calib_imu_to_velo.txt).
IMU_HEIGHT = 0.93
IMU_BEHIND_REAR_AXLE = 0.05
MEND = "unpack the day's calibration archive again"


@dataclass(frozen=True)
class KittiDrive:
    """Where one drive's files lie."""

    name: str  # "2011_09_26_drive_0013"
    calibration: Path  # the day's folder with calib_*.txt
    folder: Path  # the drive's folder with image_02, velodyne_points, oxts


def find_drive(root: Path, drive: str) -> KittiDrive:
    """Locate a synchronised drive under `root`. Raises InputError: the folder or the drive does not
    exist, or only as recorded (_extract)."""
    if not root.is_dir():
        raise InputError(root, "KITTI folder", "does not exist", "check the path")
    name = drive.removesuffix("_sync").removesuffix("_extract")
    day = root / name[:10]
    folder, recorded = day / f"{name}_sync", day / f"{name}_extract"
    if recorded.is_dir() and (drive.endswith("_extract") or not folder.is_dir()):
        problem = (
            "is the raw recording: its images are distorted and its sensors are not synchronised"
        )
        mend = f"use {folder.name}, which KITTI offers as [synced+rectified data]"
        raise InputError(recorded, "drive", problem, mend)
    if not folder.is_dir() or drive.endswith("_extract"):
        found = (path.name for path in root.glob("????_??_??/*_sync"))
        raise unknown_drive(root, drive, found, "name the folder above 2011_09_26")
    return KittiDrive(name, day, folder)


@dataclass(frozen=True)
class SensorFiles:
    """Frames of one sensor that exist on disk."""

    indices: Int64Array  # (F,) frame numbers, ascending; gaps are normal
    timestamps_us: Int64Array  # (F,) int64
    paths: tuple[Path, ...]  # F files


def list_frames(sensor: Path, *suffixes: str) -> SensorFiles:
    """List the frames of one sensor folder and their times; timestamps.txt may list more.

    Args:
        suffixes: suffixes of the files, lower case.

    Raises:
        InputError: no frames, a frame without a timestamp, or timestamps out of order.
    """
    paths = files_of(sensor / "data", suffixes)
    if not paths:
        raise InputError(
            sensor / "data", f"*{suffixes[-1]}", "there are no such files", "check the download"
        )
    for path in paths:
        if not _FRAME.fullmatch(path.stem):
            raise InputError(path, "file name", "is not a frame number", "remove the file")
    paths.sort(key=lambda path: int(path.stem))
    indices = np.array([int(path.stem) for path in paths], np.int64)
    twice = np.flatnonzero(np.diff(indices) == 0)
    if len(twice):
        problem = f"is frame {indices[twice[0]]}, and so is {paths[twice[0] + 1].name}"
        raise InputError(paths[twice[0]], "file name", problem, "remove one of the two")
    times = read_timestamps(sensor / "timestamps.txt")
    if indices[-1] >= len(times):
        raise InputError(
            sensor / "timestamps.txt",
            f"line {indices[-1] + 1}",
            f"is missing, frame {paths[-1].name} has no timestamp",
            "download the file again",
        )
    chosen = times[indices]
    if np.any(chosen == MISSING):
        frame = int(np.argmax(chosen == MISSING))
        problem = f"is empty, but the frame has the file {paths[frame].name}"
        mend = "download the file again, or delete the frame to do without it"
        raise InputError(sensor / "timestamps.txt", f"line {indices[frame] + 1}", problem, mend)
    late = np.flatnonzero(np.diff(chosen) <= 0)
    if len(late):
        line, before = indices[late[0] + 1] + 1, indices[late[0]] + 1
        raise InputError(
            sensor / "timestamps.txt",
            f"line {line}",
            f"is not later than line {before}: timestamps out of order",
            "download the file again",
        )
    return SensorFiles(indices, chosen, tuple(paths))


def read_timestamps(path: Path) -> Int64Array:
    """Times (F,) int64 microseconds since 1970 of "2011-09-26 13:10:51.168593664" lines.

    The line of a frame that was not recorded is empty: its time is `MISSING`.

    Raises:
        InputError: the file is missing or a line is not a time.
    """
    times = []
    for number, line in enumerate(files.read_text(path, TEXT_LIMIT).rstrip().split("\n"), start=1):
        time = line.strip()
        if not time:
            times.append(MISSING)
            continue
        try:
            if not _TIME.fullmatch(time):
                raise ValueError
            nanoseconds = np.datetime64(time.replace(" ", "T"), "ns").astype(np.int64)
        except ValueError:
            problem = f"{time!r} is not a time"
            raise InputError(path, f"line {number}", problem, "download it again") from None
        times.append(int(nanoseconds) // 1000)
    return np.array(times, np.int64)


def read_numbers(path: Path) -> Array:
    """All whitespace-separated numbers of a text file. Raises InputError: missing, or something in
    it is not a number."""
    text = files.read_text(path, TEXT_LIMIT)
    try:
        return np.array([float(word) for word in words_of(text)])
    except ValueError as error:
        problem = f"cannot be read ({error})"
        raise InputError(path, "numbers", problem, "download it again") from None


@dataclass(frozen=True)
class KittiCalibration:
    """Where the sensors sit on the car."""

    # rig_from_imu, rig_from_velodyne, rig_from_rectified: (4, 4); "rectified" is the rectified
    # frame of camera 0, in which tracking labels are given.
    rig_from_imu: Array
    rig_from_velodyne: Array
    rig_from_rectified: Array
    cameras: dict[str, PinholeCamera]  # intrinsics of the rectified images by name ("image_02")
    rig_from_camera: dict[str, Array]  # (4, 4) camera poses by name

    def seen_from(self, other_from_rig: Array) -> KittiCalibration:
        """The same mounting in another rig frame."""
        return replace(
            self,
            rig_from_imu=other_from_rig @ self.rig_from_imu,
            rig_from_velodyne=other_from_rig @ self.rig_from_velodyne,
            rig_from_rectified=other_from_rig @ self.rig_from_rectified,
            rig_from_camera={n: other_from_rig @ pose for n, pose in self.rig_from_camera.items()},
        )


def read_calibration(folder: Path, cameras: tuple[str, ...]) -> KittiCalibration:
    """Read calib_cam_to_cam.txt, calib_velo_to_cam.txt and calib_imu_to_velo.txt.

    Raises:
        InputError: a file or field is missing or malformed, or a camera is unknown.
    """
    cam_file = folder / "calib_cam_to_cam.txt"
    cam = _read(cam_file)
    velo_file, imu_file = folder / "calib_velo_to_cam.txt", folder / "calib_imu_to_velo.txt"
    camera_from_velodyne = _rigid(_read(velo_file), velo_file)
    velodyne_from_imu = _rigid(_read(imu_file), imu_file)

    lateral = velodyne_from_imu[1, 3]
    rig_from_imu = se3.from_rotation_translation(
        np.eye(3), [-IMU_BEHIND_REAR_AXLE, lateral, IMU_HEIGHT]
    )
    rectification = _rotation(cam, cam_file, "R_rect_00")
    rectified_from_camera = se3.from_rotation_translation(rectification, np.zeros(3))
    rectified_from_velodyne = rectified_from_camera @ camera_from_velodyne
    rig_from_velodyne = rig_from_imu @ se3.inverse(velodyne_from_imu)
    rig_from_rectified = rig_from_velodyne @ se3.inverse(rectified_from_velodyne)

    intrinsics: dict[str, PinholeCamera] = {}
    mounts: dict[str, Array] = {}
    for name in cameras:
        intrinsics[name], translation = _camera(cam, cam_file, name.removeprefix("image_"))
        camera_from_rectified = se3.from_rotation_translation(np.eye(3), translation)
        mounts[name] = rig_from_rectified @ se3.inverse(camera_from_rectified)
    return KittiCalibration(rig_from_imu, rig_from_velodyne, rig_from_rectified, intrinsics, mounts)


def _camera(values: dict[str, str], path: Path, number: str) -> tuple[PinholeCamera, Array]:
    """Intrinsics of a rectified camera, and t of its P = K [I | t]: from the rectified frame of
    camera 0 to its own is a translation only.
    """
    field, size = f"P_rect_{number}", f"S_rect_{number}"
    projection = _field(values, path, field, 12).reshape(3, 4)
    width, height = _field(values, path, size, 2).tolist()
    K = projection[:, :3]
    if not (width.is_integer() and height.is_integer()):
        raise InputError(path, size, f"{width} x {height} is not a size in pixels", MEND)
    # KITTI counts pixel centres from 0, we from 0.5.
    camera = PinholeCamera(int(width), int(height), K[0, 0], K[1, 1], K[0, 2] + 0.5, K[1, 2] + 0.5)
    with refused(path, MEND):
        camera.validate()
        if np.any(K[[0, 1, 2, 2, 2], [1, 0, 0, 1, 2]] != [0, 0, 0, 0, 1]):
            raise ValueError(f"{field}: is not the projection of a rectified camera")
        translation = np.asarray(np.linalg.solve(K, projection[:, 3]), np.float64)
        check_reach(field, translation, SENSOR_REACH)
    return camera, translation


def _read(path: Path) -> dict[str, str]:
    if not path.is_file():
        raise InputError(
            path,
            "calibration file",
            "is missing",
            "unpack the day's calibration archive (e.g. 2011_09_26_calib.zip) beside the drive",
        )
    lines = files.read_text(path, TEXT_LIMIT).splitlines()
    pairs = (line.partition(":") for line in lines if ":" in line)
    return {key.strip(): value for key, _, value in pairs}


def _field(values: dict[str, str], path: Path, name: str, count: int) -> Array:
    if name not in values:
        raise InputError(path, name, "is missing", MEND)
    try:
        numbers = np.array([float(word) for word in values[name].split()])
    except ValueError:
        raise InputError(path, name, "is not a list of numbers", MEND) from None
    if numbers.shape != (count,):
        raise InputError(path, name, f"expected {count} numbers, got {len(numbers)}", MEND)
    if not np.all(np.isfinite(numbers)):
        raise InputError(path, name, "holds NaN or infinity", MEND)
    return numbers


def _rigid(values: dict[str, str], path: Path) -> Array:
    rotation, translation = _rotation(values, path, "R"), _field(values, path, "T", 3)
    with refused(path, MEND):
        check_reach("T", translation, SENSOR_REACH)
    return se3.from_rotation_translation(rotation, translation)


def _rotation(values: dict[str, str], path: Path, name: str) -> Array:
    """The rotation nearest to nine printed numbers: their seven digits are not quite orthogonal."""
    rotation = nearest_rotation(_field(values, path, name, 9).reshape(3, 3))
    if rotation is None:
        raise InputError(path, name, "is not a rotation", MEND)
    return rotation


# KITTI velodyne sweeps and OXTS GPS/IMU packets: points when they were measured, ego poses.
#
# The HDL-64E turns ten times a second, clockwise seen from above. A turn begins and ends facing
# backwards; timestamps.txt has the moment at which it faces forward.
#
# Source of the poses: KITTI raw development kit, readme.txt and convertOxtsToPose: Mercator
# projection with the scale of the drive's first latitude; roll, pitch, yaw as R_z(yaw) R_y(pitch)
# R_x(roll); x points east, z up.

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
    """Sweeps of one drive that exist on disk."""

    # trigger_us, start_us, end_us: (S,) int64, facing forward, first and last firing.
    trigger_us: Int64Array
    start_us: Int64Array
    end_us: Int64Array
    paths: tuple[Path, ...]  # S files

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
    """List the sweeps in velodyne_points and check their sizes. Raises InputError: no sweeps, one
    is cut off, or timestamps are missing or out of order."""
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
    """The times (F,) of a file, missing ones interpolated. Raises InputError: see
    `read_timestamps`; or fewer than two lines have a time."""
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
    """Check that sweep files hold whole points. Raises InputError: one is empty or cut off."""
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
    """Packets (F, 30): latitude, longitude, altitude, roll, pitch, yaw, velocities and more. Raises
    InputError: a packet has too few fields, is not finite, or the frames have a gap over 1 s."""
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
