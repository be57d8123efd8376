"""KITTI raw calibration files and the mounting of the sensors on the car.

Source: Geiger et al., "Vision meets Robotics: The KITTI Dataset" (IJRR 2013), section 3, figure 3.
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np

from recast import storage
from recast.errors import InputError
from recast.geometry import PinholeCamera, se3
from recast.logs.checks import SENSOR_REACH, check_reach, refused
from recast.logs.importers.kitti_files import TEXT_LIMIT
from recast.logs.types import Array

# The GPS/IMU sits 0.93 m above the ground, 0.05 m behind the rear axle and 0.32 m left of the
# velodyne, which stands on the car's centre line (figure 3, and T of calib_imu_to_velo.txt).
IMU_HEIGHT = 0.93
IMU_BEHIND_REAR_AXLE = 0.05
ORTHOGONAL = 1e-3  # seven digits are printed
MEND = "unpack the day's calibration archive again"


@dataclass(frozen=True)
class KittiCalibration:
    """Where the sensors sit on the car.

    Attributes:
        rig_from_imu, rig_from_velodyne, rig_from_rectified: (4, 4); "rectified" is the rectified
            frame of camera 0, in which tracking labels are given.
        cameras: intrinsics of the rectified images by name ("image_02").
        rig_from_camera: (4, 4) by name.
    """

    rig_from_imu: Array
    rig_from_velodyne: Array
    rig_from_rectified: Array
    cameras: dict[str, PinholeCamera]
    rig_from_camera: dict[str, Array]

    def seen_from(self, other_from_rig: Array) -> KittiCalibration:
        """The same mounting told in another rig frame."""
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
        raise InputError(path, size, f"{width} x {height} are no pixels", MEND)
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
    lines = storage.read_text(path, TEXT_LIMIT).splitlines()
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
        raise InputError(path, name, f"expected {count} numbers, found {len(numbers)}", MEND)
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
    printed = _field(values, path, name, 9).reshape(3, 3)
    u, _, vt = np.linalg.svd(printed)
    rotation: Array = u @ vt
    if np.linalg.det(rotation) < 0 or np.abs(rotation - printed).max() > ORTHOGONAL:
        raise InputError(path, name, "is not a rotation", MEND)
    return rotation
