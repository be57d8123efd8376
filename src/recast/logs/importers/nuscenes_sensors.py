"""nuScenes cameras and LiDAR: calibration, and sweeps read on demand."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path

import numpy as np

from recast.errors import InputError
from recast.geometry import PinholeCamera, se3
from recast.logs.importers.nuscenes_tables import (
    AnnotationRow,
    CalibratedSensorRow,
    EgoPoseRow,
    SampleDataRow,
)
from recast.logs.importers.point_files import read_points
from recast.logs.types import Array, Int64Array, LidarSweep

POINT_FLOATS = 5  # x, y, z, intensity, ring
OWN_ROOF = 1.0
"""Metres beside the LiDAR within which it sees nothing but the roof it stands on."""
_UNIT = 1e-3
_MEND = "unpack the split's metadata archive again"


def pose_of(path: Path, row: EgoPoseRow | CalibratedSensorRow | AnnotationRow) -> Array:
    """The transform (4, 4) of a row's rotation (wxyz) and translation.

    Raises:
        InputError: the quaternion is not of unit length.
    """
    length = float(np.linalg.norm(row.rotation))
    if abs(length - 1.0) > _UNIT:
        problem = f"is no rotation: the quaternion's length is {length:.4g}, not 1"
        raise InputError(path, f"token {row.token}: rotation", problem, _MEND)
    return se3.from_rotation_translation(se3.quat_to_matrix(row.rotation), row.translation)


def camera_of(tables: Path, row: CalibratedSensorRow, frames: list[SampleDataRow]) -> PinholeCamera:
    """Intrinsics of a camera whose images (undistorted by the dataset's makers) are `frames`.

    Raises:
        InputError: the camera has no intrinsics or impossible ones, or its images differ in size.
    """
    path = tables / "calibrated_sensor.json"
    field = f"token {row.token}: camera_intrinsic"
    matrix = row.camera_intrinsic
    if not matrix:
        raise InputError(path, field, "is empty: a camera without calibration", _MEND)
    if [len(line) for line in matrix] != [3, 3, 3]:
        raise InputError(path, field, "is no 3x3 matrix", _MEND)
    (fx, skew, cx), (lower, fy, cy), last = matrix
    if skew or lower or last != [0.0, 0.0, 1.0]:
        raise InputError(path, field, f"{matrix} is no pinhole camera without skew", _MEND)
    width, height = frames[0].width, frames[0].height
    for frame in frames:
        if (frame.width, frame.height) != (width, height):
            problem = f"{frame.width}x{frame.height}, the camera's first is {width}x{height}"
            raise InputError(
                tables / "sample_data.json", f"token {frame.token}: width, height", problem, _MEND
            )
    # Projection in the dataset's own tools counts pixel centres from 0, we from 0.5.
    camera = PinholeCamera(width, height, fx, fy, cx + 0.5, cy + 0.5)
    try:
        camera.validate()
    except ValueError as error:
        raise InputError(path, field, str(error), _MEND) from None
    return camera


@dataclass(frozen=True)
class NuScenesSweeps:
    """Sweeps read from .pcd.bin files on demand; a `SweepSource`.

    Points are in the sensor's frame at the sweep's time, ego motion undone by the dataset's makers
    (Caesar et al., CVPR 2020), so no point has a time of its own.

    Attributes:
        timestamps_us: (S,) int64.
        paths: S files of float32 x, y, z (metres), intensity (0 to 255), ring.
        rig_from_lidar: (4, 4).
    """

    timestamps_us: Int64Array
    paths: tuple[Path, ...]
    rig_from_lidar: Array

    def __len__(self) -> int:
        """Number of sweeps."""
        return len(self.paths)

    def __getitem__(self, index: int) -> LidarSweep:
        """Read sweep `index`.

        Raises:
            InputError: the file is empty, cut off or not finite.
        """
        path = self.paths[index]
        rows = read_points(path, POINT_FLOATS, range(POINT_FLOATS), "download the file again")
        rows = rows[np.abs(rows[:, :2]).max(axis=1) > OWN_ROOF]
        points = se3.apply(self.rig_from_lidar, rows[:, :3]).astype(np.float32)
        intensity = np.clip(rows[:, 3] / np.float32(255), 0.0, 1.0)
        return LidarSweep(int(self.timestamps_us[index]), points, intensity)
