"""Argoverse 2 calibration, images and LiDAR sweeps.

Images are already undistorted: the coefficients k1, k2, k3 of intrinsics.feather are those of the
lenses and do not belong to the images (av2-api, issues 219 and 226), so they are not read.
"""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path

import numpy as np

from recast.errors import InputError
from recast.geometry import PinholeCamera
from recast.logs.importers.argoverse2_files import TimedFiles
from recast.logs.importers.argoverse2_tables import POSE, poses, read_columns
from recast.logs.types import Array, LidarSweep

INTRINSICS = "intrinsics.feather"
EXTRINSICS = "egovehicle_SE3_sensor.feather"
LASERS = {"up_lidar": range(32), "down_lidar": range(32, 64)}
"""Laser numbers of the two stacked scanners. Measured: with the ego motion put back, each laser's
elevation in its own scanner's frame is constant to 0.004 degrees; in the other's it varies by 0.15.
"""
TURN_US = 120_000
"""No point of a sweep is measured later after the sweep's time (in real logs up to 106 ms)."""

_MEND = "download the log again"


@dataclass(frozen=True)
class Calibration:
    """Mounting of the sensors, by name.

    Attributes:
        cameras: intrinsics of the (undistorted) images.
        ego_from_sensor: (4, 4) of cameras (OpenCV axes) and LiDARs.
    """

    cameras: dict[str, PinholeCamera]
    ego_from_sensor: dict[str, Array]


def read_calibration(folder: Path) -> Calibration:
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
    return Calibration(cameras, ego_from_sensor)


def check_sensors(log: Path, calibration: Calibration) -> None:
    """Every camera folder has a camera, and where there are sweeps, there are both LiDARs.

    Raises:
        InputError: one has no calibration.
    """
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

    Attributes:
        files: one for each sweep.
        lasers: laser numbers of this LiDAR.
        rig_from_ego: (4, 4).
    """

    files: TimedFiles
    lasers: range
    rig_from_ego: Array

    def __len__(self) -> int:
        """Number of sweeps."""
        return len(self.files.paths)

    def __getitem__(self, index: int) -> LidarSweep:
        """Read sweep `index`.

        Raises:
            InputError: the file, a column or a value is wrong.
        """
        path, time = self.files.paths[index], int(self.files.timestamps_us[index])
        rows = read_columns(path, ("x", "y", "z", "intensity", "laser_number", "offset_ns"))
        offset = rows["offset_ns"].astype(np.int64) // 1000
        _refuse_outside(path, "offset_ns", rows["offset_ns"], 0, 1000 * TURN_US)
        _refuse_outside(path, "laser_number", rows["laser_number"], 0, 63)
        _refuse_outside(path, "intensity", rows["intensity"], 0, 255)
        mine = np.isin(rows["laser_number"], self.lasers)
        in_ego = np.stack([rows[axis][mine].astype(np.float64) for axis in "xyz"], axis=-1)
        in_rig = in_ego @ self.rig_from_ego[:3, :3].T + self.rig_from_ego[:3, 3]
        return LidarSweep(
            time,
            in_rig.astype(np.float32),
            rows["intensity"][mine].astype(np.float32) / np.float32(255),
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
