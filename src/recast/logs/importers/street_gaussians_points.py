"""Street Gaussians' pointcloud.npz, converted to plain arrays, as LiDAR sweeps.

The original file is a pickle: loading it would run whatever code is in it, so it is refused.
"""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path
from zipfile import ZipFile, is_zipfile

import numpy as np

from recast.errors import InputError
from recast.geometry import se3
from recast.logs import checks
from recast.logs.importers.processed_folder import NUMBER
from recast.logs.importers.street_gaussians_ego import Drive
from recast.logs.types import Array, LidarStream, LidarSweep
from recast.tables import npz_array, npz_names, open_npz

NAME = "lidar"
RIG_FROM_LIDAR = se3.from_rotation_translation(np.eye(3), [1.43, 0.0, 2.18])
"""About where Waymo's top LiDAR stands: the file does not say which of five saw a point."""
_LARGEST = 1 << 28
"""Bytes of a sweep."""
_CONVERT = "convert it as docs/data.md says, or remove it to do without LiDAR"


def read_lidar(path: Path, drive: Drive) -> dict[str, LidarStream]:
    """The sweeps of a file of one array (N, 3) for each frame; none where there is no such file.

    Raises:
        InputError: the file is broken or holds pickled objects, or a frame is unknown.
    """
    if not path.is_file():
        return {}
    if not is_zipfile(path):
        raise InputError(path, "file", "is no .npz archive; a pickle is never loaded", _CONVERT)
    with open_npz(path, _CONVERT) as arrays:
        names = npz_names(arrays)
        if names:
            _array(path, arrays, names[0])
    for name in names:
        if not NUMBER.fullmatch(name) or int(name) not in drive.frame_times:
            problem = "is no frame that has an ego pose"
            raise InputError(path, f"array {name}", problem, "take the points of this scene")
    names.sort(key=int)
    times = np.array([drive.frame_times[int(name)] for name in names], np.int64)
    sweeps = StreetGaussiansSweeps(path, tuple(names), drive)
    return {NAME: LidarStream(NAME, RIG_FROM_LIDAR, times, sweeps)}


@dataclass(frozen=True)
class StreetGaussiansSweeps:
    """Sweeps read from the file on demand; a `SweepSource`. They have no intensity: it is zero.

    Attributes:
        path: .npz file.
        names: S arrays in it, named by frame.
        drive: times and poses.
    """

    path: Path
    names: tuple[str, ...]
    drive: Drive

    def __len__(self) -> int:
        """Number of sweeps."""
        return len(self.names)

    def __getitem__(self, index: int) -> LidarSweep:
        """Read sweep `index`.

        Raises:
            InputError: the file is broken, or the array is not (N, 3) finite numbers.
        """
        name = self.names[index]
        with open_npz(self.path, _CONVERT) as arrays:
            in_vehicle = _array(self.path, arrays, name)
        time = self.drive.frame_times[int(name)]
        rig_from_world = se3.inverse(self.drive.world_from_rig.at(time))
        rig_from_vehicle = rig_from_world @ self.drive.world_from_frame[int(name)]
        points = se3.apply(rig_from_vehicle, in_vehicle).astype(np.float32)
        return LidarSweep(time, points, np.zeros(len(points), np.float32))


def _array(path: Path, arrays: ZipFile, name: str) -> Array:
    points = npz_array(path, arrays, name, _CONVERT, _LARGEST)
    if points.ndim != 2 or points.shape[1] != 3 or points.dtype.kind != "f":
        problem = f"is {points.dtype} of shape {points.shape}, not points (N, 3)"
        raise InputError(path, f"array {name}", problem, _CONVERT)
    if not np.all(np.abs(points) <= checks.SENSOR_REACH):  # also NaN
        problem = f"holds NaN or infinity, or a point not within {checks.SENSOR_REACH:g} m"
        raise InputError(path, f"array {name}", problem, _CONVERT)
    return points.astype(np.float64)
