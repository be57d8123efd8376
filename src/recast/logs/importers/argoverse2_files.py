"""The files of an Argoverse 2 log: where they lie, their tables, calibration and LiDAR sweeps.

Images are already undistorted: the coefficients k1, k2, k3 of intrinsics.feather are those of the
lenses and do not belong to the images (av2-api, issues 219 and 226), so they are not read.
"""

from __future__ import annotations

import glob
import re
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from recast.cameras import PinholeCamera
from recast.core.errors import InputError
from recast.core.table_files import read_feather
from recast.geometry import se3
from recast.logs import checks
from recast.logs.importers.common import (
    are_returns,
    check_drive,
    files_of,
    unit_intensity,
    unknown_drive,
)
from recast.logs.types import Array, Int64Array, LidarSweep

POSES = "city_SE3_egovehicle.feather"
_NANOSECONDS = re.compile(r"[0-9]{1,19}")
QUATERNION = ("qw", "qx", "qy", "qz")
TRANSLATION = ("tx_m", "ty_m", "tz_m")
POSE = (*QUATERNION, *TRANSLATION)
TIME = "timestamp_ns"
_UNIT = 1e-3
_MEND = "download the log again"

Columns = dict[str, NDArray[Any]]
INTRINSICS = "intrinsics.feather"
EXTRINSICS = "egovehicle_SE3_sensor.feather"
LASERS = {"up_lidar": range(32), "down_lidar": range(32, 64)}
"""Laser numbers of the two stacked scanners. Measured: with the ego motion put back, each laser's
elevation in its own scanner's frame is constant to 0.004 degrees; in the other's it varies by 0.15.
"""
TURN_US = 120_000
"""No point of a sweep is measured later after the sweep's time (in real logs up to 106 ms)."""


def find_log(root: Path, drive: str) -> Path:
    """The folder of a log: in `root`, in a split below it, or `root` itself. Raises InputError: the
    folder or the log does not exist."""
    if not root.is_dir():
        raise InputError(root, "Argoverse 2 folder", "does not exist", "check the path")
    check_drive(root, drive)
    for folder in (root / drive, *sorted(root.glob(f"*/{glob.escape(drive)}")), root):
        if folder.name == drive and folder.is_dir():
            return folder
    found = (path.parent.name for path in (*root.glob(f"*/{POSES}"), *root.glob(f"*/*/{POSES}")))
    raise unknown_drive(root, drive, found, "name the folder that holds train, val or test")


@dataclass(frozen=True)
class TimedFiles:
    """Frames of one sensor, named after their time."""

    timestamps_us: Int64Array  # (F,) int64, strictly increasing
    paths: tuple[Path, ...]  # F files

    def within(self, first_us: int, last_us: int) -> TimedFiles:
        """Those with a time in [first_us, last_us]."""
        kept = np.flatnonzero((self.timestamps_us >= first_us) & (self.timestamps_us <= last_us))
        return TimedFiles(self.timestamps_us[kept], tuple(self.paths[i] for i in kept))


def list_frames(folder: Path, *suffixes: str) -> TimedFiles:
    """Frames `<nanoseconds><suffix>` in the order of time; none where there is no such folder.

    Args:
        suffixes: suffixes of the files, lower case.

    Raises:
        InputError: a name is no time, or two frames have the same microsecond.
    """
    paths = files_of(folder, suffixes)
    for path in paths:
        if not _NANOSECONDS.fullmatch(path.stem) or int(path.stem) >= 1000 * checks.LATEST_US:
            raise InputError(path, "file name", "is not a time in nanoseconds", "remove the file")
    paths.sort(key=lambda path: int(path.stem))
    times = np.array([int(path.stem) for path in paths], np.int64) // 1000
    same = np.flatnonzero(np.diff(times) <= 0)
    if len(same):
        raise InputError(
            paths[same[0] + 1],
            "file name",
            f"is less than a microsecond after {paths[same[0]].name}",
            "remove one of them",
        )
    return TimedFiles(times, tuple(paths))


def read_columns(
    path: Path, numbers: Sequence[str], words: Sequence[str] = (), gaps: Sequence[str] = ()
) -> Columns:
    """Columns (N,) of a feather file by name; others it may have are not looked at.

    Args:
        numbers: columns of integers or floats, all of which must be finite; kept as stored.
        words: columns of text.
        gaps: columns of numbers that need not be finite.

    Raises:
        InputError: see `read_feather` and `ArrowTable`.
    """
    table = read_feather(path, [*numbers, *words, *gaps], _MEND)
    return {
        **{name: table.numbers(name, finite=False) for name in gaps},
        **{name: table.numbers(name) for name in numbers},
        **{name: table.words(name) for name in words},
    }


def times_of(path: Path, columns: Columns) -> Int64Array:
    """Times (N,) of a table in nanoseconds. Raises InputError: one is no integer, or lies outside
    of what a log can hold."""
    values = columns[TIME]
    latest = 1000 * checks.LATEST_US
    wrong = np.flatnonzero((values < 0) | (values >= latest) | (values != np.trunc(values)))
    if len(wrong):
        problem = f"{values[wrong[0]]} is not a time in nanoseconds"
        raise InputError(path, f"{TIME} in row {wrong[0]}", problem, _MEND)
    return values.astype(np.int64)


def poses(path: Path, columns: Columns) -> Array:
    """Transforms (N, 4, 4) of the quaternions and translations of a table. Raises InputError: a
    quaternion is not of unit length, or a translation is of no place on Earth."""
    quat = np.stack([columns[name].astype(np.float64) for name in QUATERNION], axis=-1)
    with np.errstate(over="ignore"):
        norm = np.linalg.norm(quat, axis=-1)
    wrong = np.flatnonzero(np.abs(norm - 1.0) > _UNIT)
    if len(wrong):
        raise InputError(
            path,
            f"qw, qx, qy, qz in row {wrong[0]}",
            f"are not a rotation: the length of the quaternion is {norm[wrong[0]]:.4g}, not 1",
            _MEND,
        )
    translation = np.stack([columns[name].astype(np.float64) for name in TRANSLATION], axis=-1)
    far = np.flatnonzero((np.abs(translation) > checks.WORLD_REACH).any(axis=-1))
    if len(far):
        problem = f"{translation[far[0]].tolist()} is not within {checks.WORLD_REACH:g} m"
        raise InputError(path, f"tx_m, ty_m, tz_m in row {far[0]}", problem, _MEND)
    return se3.from_rotation_translation(se3.quat_to_matrix(quat), translation)


@dataclass(frozen=True)
class RigCalibration:
    """Mounting of the sensors, by name."""

    cameras: dict[str, PinholeCamera]  # intrinsics of the (undistorted) images
    ego_from_sensor: dict[str, Array]  # (4, 4) poses of cameras (OpenCV axes) and LiDARs


def read_calibration(folder: Path) -> RigCalibration:
    """Read intrinsics.feather and egovehicle_SE3_sensor.feather.

    Raises:
        InputError: a file or column is missing or wrong, or a camera's mounting is missing.
    """
    path = folder / INTRINSICS
    rows = read_columns(
        path, ("fx_px", "fy_px", "cx_px", "cy_px", "width_px", "height_px"), ("sensor_name",)
    )
    cameras = {}
    for i, name in enumerate(rows["sensor_name"].tolist()):
        fx, fy, cx, cy = (float(rows[key][i]) for key in ("fx_px", "fy_px", "cx_px", "cy_px"))
        # The dataset counts pixel centres from 0, we from 0.5.
        camera = PinholeCamera(
            int(rows["width_px"][i]), int(rows["height_px"][i]), fx, fy, cx + 0.5, cy + 0.5
        )
        try:
            camera.validate()
        except ValueError as error:
            raise InputError(path, f"sensor {name}", str(error), _MEND) from None
        cameras[name] = camera
    mounts = folder / EXTRINSICS
    placed = read_columns(mounts, POSE, ("sensor_name",))
    ego_from_sensor = dict(zip(placed["sensor_name"].tolist(), poses(mounts, placed), strict=True))
    for name in cameras:
        _mount(folder, ego_from_sensor, name)
    return RigCalibration(cameras, ego_from_sensor)


def check_sensors(log: Path, calibration: RigCalibration) -> None:
    """Every camera folder has a camera, and where there are sweeps, there are both LiDARs. Raises
    InputError: one has no calibration."""
    for folder in sorted(log.glob("sensors/cameras/*/")):
        if folder.name not in calibration.cameras:
            raise InputError(
                log / "calibration" / INTRINSICS,
                f"sensor_name {folder.name}",
                "is missing, but the log has images of this camera",
                f"remove {folder} or download the log again",
            )
    if (log / "sensors" / "lidar").is_dir():
        for name in LASERS:
            _mount(log / "calibration", calibration.ego_from_sensor, name)


def _mount(folder: Path, ego_from_sensor: dict[str, Array], name: str) -> None:
    if name not in ego_from_sensor:
        raise InputError(folder / EXTRINSICS, f"sensor_name {name}", "is missing", _MEND)


@dataclass(frozen=True)
class Argoverse2Sweeps:
    """The points of one LiDAR in the sweep files of both, read on demand.

    The files hold points in the ego frame at the sweep's time, ego motion undone.
    """

    files: TimedFiles  # one for each sweep
    lasers: range  # laser numbers of this LiDAR
    # ego_from_lidar, rig_from_ego: (4, 4).
    ego_from_lidar: Array
    rig_from_ego: Array

    def __len__(self) -> int:
        """Number of sweeps."""
        return len(self.files.paths)

    def __getitem__(self, index: int) -> LidarSweep:
        """Read sweep `index`. Raises InputError: the file, a column or a value is wrong."""
        path, time = self.files.paths[index], int(self.files.timestamps_us[index])
        rows = read_columns(path, ("intensity", "laser_number", "offset_ns"), gaps="xyz")
        offset = rows["offset_ns"].astype(np.int64) // 1000
        _refuse_outside(path, "offset_ns", rows["offset_ns"], 0, 1000 * TURN_US)
        _refuse_outside(path, "laser_number", rows["laser_number"], 0, 63)
        _refuse_outside(path, "intensity", rows["intensity"], 0, 255)
        mine = np.isin(rows["laser_number"], self.lasers)
        in_ego = np.stack([rows[axis].astype(np.float64) for axis in "xyz"], axis=-1)
        mine &= are_returns(in_ego, self.ego_from_lidar[:3, 3])
        in_rig = in_ego[mine] @ self.rig_from_ego[:3, :3].T + self.rig_from_ego[:3, 3]
        return LidarSweep(
            time,
            in_rig.astype(np.float32),
            unit_intensity(rows["intensity"][mine]),
            time + offset[mine],
        )


def _refuse_outside(path: Path, name: str, values: Array, low: int, high: int) -> None:
    wrong = np.flatnonzero((values < low) | (values > high))
    if len(wrong):
        raise InputError(
            path,
            f"column {name}, row {wrong[0]}",
            f"is {values[wrong[0]]}, not in [{low}, {high}]",
            _MEND,
        )
