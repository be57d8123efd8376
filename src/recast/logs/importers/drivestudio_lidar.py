"""DriveStudio's LiDAR files: the points of Waymo's five scanners, one file for each frame."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from recast.errors import InputError
from recast.geometry import se3
from recast.logs.importers.point_files import read_points
from recast.logs.importers.processed_folder import NUMBER
from recast.logs.importers.waymo_schema import LASER_NAME, lidar_name
from recast.logs.types import Int64Array, LidarStream, LidarSweep

LASERS = tuple(lidar_name(name) for name in LASER_NAME.names.values())
"""By number in the files, which is Waymo's LaserName less one."""
FLOATS = 14
"""Origin (3) and point (3) in the vehicle frame, flow (3), flow class, ground, intensity,
elongation, laser."""
_ORIGIN, _POINT = slice(0, 3), slice(3, 6)
_INTENSITY, _LASER = 11, 13
_MEND = "process the scene again"


def read_lidars(folder: Path, frame_times: dict[int, int]) -> dict[str, LidarStream]:
    """A stream for each scanner that the first file has points of; none without the folder.

    Their mountings are the origins of their rays there; how they are turned is not written, so
    they have the vehicle's axes.

    Args:
        frame_times: microseconds of each frame that has an ego pose.

    Raises:
        InputError: a file belongs to no frame, or the first is broken.
    """
    listed = {}
    for path in sorted(folder.glob("*.bin")):
        if not NUMBER.fullmatch(path.stem) or int(path.stem) not in frame_times:
            raise InputError(path, "file name", "is no frame that has an ego pose", _MEND)
        listed[int(path.stem)] = path
    if not listed:
        return {}
    times = np.array([frame_times[frame] for frame in sorted(listed)], np.int64)
    paths = tuple(listed[frame] for frame in sorted(listed))
    rows = read_rows(paths[0])
    lidars = {}
    for number, name in enumerate(LASERS):
        mine = rows[rows[:, _LASER] == number]
        if len(mine):
            origin = np.median(mine[:, _ORIGIN].astype(np.float64), axis=0)
            mount = se3.from_rotation_translation(np.eye(3), origin)
            sweeps = DriveStudioSweeps(times, paths, number)
            lidars[name] = LidarStream(name, mount, times, sweeps)
    return lidars


def read_rows(path: Path) -> NDArray[np.float32]:
    """Rows (N, 14) of a file.

    Raises:
        InputError: cut off, of another layout, not finite, or of an unknown scanner.
    """
    rows = read_points(path, FLOATS, [*range(0, 6), _INTENSITY, _LASER], _MEND)
    known = np.isin(rows[:, _LASER], range(len(LASERS)))
    if not known.all():
        point = int(np.argmin(known))
        problem = f"is {rows[point, _LASER]:g}, not 0 to {len(LASERS) - 1}"
        raise InputError(path, f"point {point}: laser", problem, _MEND)
    return rows


@dataclass(frozen=True)
class DriveStudioSweeps:
    """Sweeps of one scanner, read on demand; a `SweepSource`. The ego motion is undone in them.

    Attributes:
        timestamps_us: (S,) int64.
        paths: S files.
        laser: the scanner's number.
    """

    timestamps_us: Int64Array
    paths: tuple[Path, ...]
    laser: int

    def __len__(self) -> int:
        """Number of sweeps."""
        return len(self.paths)

    def __getitem__(self, index: int) -> LidarSweep:
        """Read sweep `index`.

        Raises:
            InputError: see `read_rows`.
        """
        rows = read_rows(self.paths[index])
        mine = rows[rows[:, _LASER] == self.laser]
        # Waymo's intensities have no upper bound.
        intensity = np.tanh(np.maximum(mine[:, _INTENSITY], 0.0))
        return LidarSweep(int(self.timestamps_us[index]), mine[:, _POINT], intensity)
