"""When the frames of a Street Gaussians folder were, where the ego was, and their LiDAR sweeps.

Every image has its own time and ego pose. A whole frame (its boxes and points) has the vehicle's
pose at the middle of the scan, but timestamps.json gives it the time at which the scan began,
about 50 ms earlier: the delay is measured by looking where on the images' path the pose lies.

The original pointcloud.npz is a pickle: loading it would run whatever code is in it, so it is
refused; one that was converted to plain arrays is read.
"""

from __future__ import annotations

import json
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any
from zipfile import is_zipfile

import numpy as np

from recast.core import files
from recast.core.array_files import npz_names, read_npz
from recast.core.errors import InputError
from recast.geometry import se3
from recast.logs import checks, motion
from recast.logs.importers.common import are_returns, first_jump
from recast.logs.types import Array, Int64Array, LidarStream, LidarSweep, Trajectory
from recast_bridges.logs.processed_folder import NUMBER, CameraFolder, frame_numbers, read_pose

TIMES = "timestamps.json"
USUAL_DELAY_US = 50_000
LONGEST_DELAY_US = 100_000
_DELAY_STEP_US = 1_000
_SHORTEST_PATH = 5.0
"""Metres: an ego that stands tells nothing about times."""
_BESIDE = 1.0
"""Metres that a frame's pose may be off the path of the images."""
_MEND = "process the scene again"
NAME = "lidar"
RIG_FROM_LIDAR = se3.from_rotation_translation(np.eye(3), [1.43, 0.0, 2.18])
"""About where Waymo's top LiDAR stands: the file does not say which of five saw a point."""
_LARGEST = 1 << 28
"""Bytes of a sweep."""
_CONVERT = (
    "convert it, or remove it to do without LiDAR; "
    "see docs/data.md#street-gaussians-processed-scenes"
)


@dataclass(frozen=True)
class TrainedFrames:
    """Times and poses of a scene.

    Attributes:
        world_from_rig: ego trajectory through the poses of all images.
        offset: (3,) global coordinates = world coordinates + offset.
        frame_times: microseconds by frame: when its boxes and points hold.
        world_from_frame: (4, 4) vehicle pose by frame; boxes and points are given in it.
        image_times: microseconds by camera number, then by frame.
    """

    world_from_rig: Trajectory
    offset: Array
    frame_times: dict[int, int]
    world_from_frame: dict[int, Array]
    image_times: dict[int, dict[int, int]]


def read_drive(scene: Path, cameras: Sequence[CameraFolder]) -> TrainedFrames:
    """Read timestamps.json and ego_pose.

    Raises:
        InputError: a file or time is missing or wrong, or poses are not all of one frame.
    """
    if not cameras:
        raise InputError(scene / "images", "images", "there are none", _MEND)
    times = files.read_json(scene / TIMES)
    poses = scene / "ego_pose"
    image_times = {
        camera.number: {k: _time(scene / TIMES, times, camera.name, k) for k in camera.images}
        for camera in cameras
    }
    timed = sorted(
        (time, poses / f"{frame:06d}_{number}.txt")
        for number, of_camera in image_times.items()
        for frame, time in of_camera.items()
    )
    all_times = np.array([time for time, _ in timed], np.int64)
    placed = np.stack([read_pose(path) for _, path in timed])
    jump = first_jump(all_times, placed)
    if jump is not None:
        problem = f"is {jump[1]:.0f} m from the image before: mixed coordinate frames"
        raise InputError(timed[jump[0]][1], "matrix", problem, _MEND)
    unique, first = np.unique(all_times, return_index=True)
    offset: Array = placed[0, :3, 3].copy()
    placed[:, :3, 3] -= offset
    images = Trajectory(unique, placed[first])

    frames = frame_numbers(poses)
    began = {frame: _time(scene / TIMES, times, "FRAME", frame) for frame in frames}
    world_from_frame = {frame: read_pose(path) for frame, path in frames.items()}
    for pose in world_from_frame.values():
        pose[:3, 3] -= offset
    starts = np.array(list(began.values()), np.int64)
    late = np.flatnonzero(np.diff(starts) <= 0)
    if len(late):
        field = f"FRAME.{list(began)[late[0] + 1]:06d}"
        raise InputError(scene / TIMES, field, "is not later than the frame before", _MEND)
    delay = _delay(starts, np.stack(list(world_from_frame.values())), images)
    frame_times = {frame: time + delay for frame, time in began.items()}
    spanned = [*frame_times.values(), int(unique[0]), int(unique[-1])]
    trajectory = motion.extended(images, min(spanned), max(spanned))
    for frame, path in frames.items():
        if not trajectory.covers(frame_times[frame]):
            problem = "lies outside the times of all images"
            raise InputError(scene / TIMES, f"FRAME.{path.stem}", problem, _MEND)
        beside = trajectory.at(frame_times[frame])[:3, 3] - world_from_frame[frame][:3, 3]
        if (distance := float(np.linalg.norm(beside))) > _BESIDE:
            problem = f"is {distance:.0f} m from the path of the images: mixed coordinate frames"
            raise InputError(path, "matrix", problem, _MEND)
    return TrainedFrames(trajectory, offset, frame_times, world_from_frame, image_times)


def _time(path: Path, times: Any, sensor: str, frame: int) -> int:
    """Microseconds of `times[sensor][frame]`, which are seconds."""
    of_sensor = times.get(sensor) if isinstance(times, dict) else None
    seconds = of_sensor.get(f"{frame:06d}") if isinstance(of_sensor, dict) else None
    if not isinstance(seconds, (int, float)) or not 0 <= seconds < 1e10:
        problem = "is missing" if seconds is None else f"{json.dumps(seconds)} is not a time"
        raise InputError(path, f"{sensor}.{frame:06d}", problem, _MEND)
    return round(seconds * 1e6)


def _delay(starts_us: Int64Array, world_from_frame: Array, images: Trajectory) -> int:
    """Microseconds from the beginning of a scan to the time of the frame's pose."""
    path = np.linalg.norm(np.diff(images.poses[:, :3, 3], axis=0), axis=1).sum()
    first, last = images.timestamps_us[[0, -1]]
    inside = (starts_us >= first) & (starts_us + LONGEST_DELAY_US <= last)
    if path < _SHORTEST_PATH or not inside.any():
        return USUAL_DELAY_US
    delays = np.arange(0, LONGEST_DELAY_US + 1, _DELAY_STEP_US)
    on_path = images.at(starts_us[inside][:, None] + delays)[..., :3, 3]
    away = np.linalg.norm(on_path - world_from_frame[inside, None, :3, 3], axis=-1)
    return int(delays[np.argmin(np.median(away, axis=0))])


def read_lidar(path: Path, drive: TrainedFrames) -> dict[str, LidarStream]:
    """The sweeps of a file of one array (N, 3) for each frame; none where there is no such file.

    Raises:
        InputError: the file is broken or holds pickled objects, or a frame is unknown.
    """
    if not path.is_file():
        return {}
    if not is_zipfile(path):
        raise InputError(path, "file", "is not an .npz archive; pickles are never loaded", _CONVERT)
    names = npz_names(path, _CONVERT)
    if names:
        _array(path, names[0])
    for name in names:
        if not NUMBER.fullmatch(name) or int(name) not in drive.frame_times:
            problem = "is not a frame with an ego pose"
            raise InputError(path, f"array {name}", problem, "use the points of this scene")
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
    drive: TrainedFrames

    def __len__(self) -> int:
        """Number of sweeps."""
        return len(self.names)

    def __getitem__(self, index: int) -> LidarSweep:
        """Read sweep `index`.

        Raises:
            InputError: the file is broken, or the array is not (N, 3) numbers in range.
        """
        name = self.names[index]
        in_vehicle = _array(self.path, name)
        time = self.drive.frame_times[int(name)]
        rig_from_world = se3.inverse(self.drive.world_from_rig.at(time))
        rig_from_vehicle = rig_from_world @ self.drive.world_from_frame[int(name)]
        points = se3.apply(rig_from_vehicle, in_vehicle).astype(np.float32)
        return LidarSweep(time, points, np.zeros(len(points), np.float32))


def _array(path: Path, name: str) -> Array:
    points = read_npz(path, _CONVERT, [name], _LARGEST)[name]
    if points.ndim != 2 or points.shape[1] != 3 or points.dtype.kind != "f":
        problem = f"is {points.dtype} of shape {points.shape}, not points (N, 3)"
        raise InputError(path, f"array {name}", problem, _CONVERT)
    points = points[are_returns(points, RIG_FROM_LIDAR[:3, 3])]
    if not np.all(np.abs(points) <= checks.SENSOR_REACH):
        problem = f"holds a point not within {checks.SENSOR_REACH:g} m"
        raise InputError(path, f"array {name}", problem, _CONVERT)
    return points.astype(np.float64)
