"""Sensors of a nuScenes scene: calibration, images and sweeps, and the ego poses of them all."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from recast.cameras import PinholeCamera
from recast.core.errors import InputError
from recast.core.names import member
from recast.geometry import se3
from recast.logs import motion
from recast.logs.importers.common import Timed, first_jump, read_points, unit_intensity
from recast.logs.importers.nuscenes_tables import (
    AnnotationRow,
    CalibratedSensorRow,
    EgoPoseRow,
    SampleDataRow,
    SampleRow,
    SensorRow,
    linked,
    select,
)
from recast.logs.types import Array, Int64Array, LidarSweep, Trajectory

POINT_FLOATS = 5  # x, y, z, intensity, ring
OWN_ROOF = 1.0
"""Metres beside the LiDAR within which it sees nothing but the roof it stands on."""
_UNIT = 1e-3
_MEND = "unpack the split's metadata archive again"
LONGEST_GAP_US = 1_000_000
_MEND_POSES = "use tables of the same metadata archive"


@dataclass(frozen=True)
class Sensor:
    """A camera or LiDAR of a scene.

    Attributes:
        kind: "camera" or "lidar".
        frames: frames in the order of time.
    """

    name: str
    kind: str
    mount: CalibratedSensorRow
    frames: list[SampleDataRow]


def read_sensors(
    root: Path, tables: Path, samples: Sequence[SampleRow], cameras: Sequence[str] = ()
) -> list[Sensor]:
    """Cameras and LiDARs of the scene whose key frames are `samples`, by name; no radars.

    Of a sensor whose files of this scene between key frames are all missing, only the key frames
    are taken: they come in other archives.
    Only the files of LiDARs and of the `cameras` wanted (all if empty) must be there.

    Raises:
        InputError: a table, column or file is missing, a token leads nowhere, a sensor has two
            calibrations or two frames of one time.
    """
    path = tables / "sample_data.json"
    frames = select(path, SampleDataRow, "sample_token", {sample.token for sample in samples})
    with_sweeps = {
        frame.calibrated_sensor_token
        for frame in frames
        if not frame.is_key_frame and (root / frame.filename).is_file()
    }
    frames = [f for f in frames if f.is_key_frame or f.calibrated_sensor_token in with_sweeps]
    mounts = linked(
        tables,
        "calibrated_sensor",
        CalibratedSensorRow,
        frames,
        "sample_data",
        "calibrated_sensor_token",
    )
    kinds = linked(
        tables, "sensor", SensorRow, list(mounts.values()), "calibrated_sensor", "sensor_token"
    )
    sensors: dict[str, Sensor] = {}
    for frame in sorted(frames, key=lambda frame: frame.timestamp):
        mount = mounts[frame.calibrated_sensor_token]
        kind = kinds[mount.sensor_token]
        if kind.modality not in ("camera", "lidar"):  # radar
            continue
        sensor = sensors.setdefault(kind.channel, Sensor(kind.channel, kind.modality, mount, []))
        _check_frame(path, frame, sensor)
        if sensor.kind == "lidar" or not cameras or sensor.name in cameras:
            _check_file(root, path, frame)
        sensor.frames.append(frame)
    return [sensors[name] for name in sorted(sensors)]


def _check_frame(path: Path, frame: SampleDataRow, sensor: Sensor) -> None:
    def refuse(column: str, problem: str, mend: str) -> InputError:
        return InputError(path, f"token {frame.token}: {column}", problem, mend)

    if frame.calibrated_sensor_token != sensor.mount.token:
        problem = f"{sensor.name} has a second calibration within the scene"
        raise refuse("calibrated_sensor_token", problem, "use tables as published")
    if sensor.frames and frame.timestamp == sensor.frames[-1].timestamp:
        problem = f"{frame.timestamp} appears twice for {sensor.name}"
        raise refuse("timestamp", problem, "use tables as published")
    formats = ("jpg", "jpeg", "png") if sensor.kind == "camera" else ("pcd", "bin")
    if frame.fileformat.lower() not in formats:
        problem = f"is {frame.fileformat!r}, not {' or '.join(formats)}"
        raise refuse("fileformat", problem, "use files as published")


def _check_file(root: Path, path: Path, frame: SampleDataRow) -> None:
    field = f"token {frame.token}: filename"
    if not member(root, frame.filename, path, field).is_file():
        problem = f"{frame.filename} is missing under {root}"
        raise InputError(path, field, problem, "unpack the file archives of this scene")


def pose_of(path: Path, row: EgoPoseRow | CalibratedSensorRow | AnnotationRow) -> Array:
    """The transform (4, 4) of a row's rotation (wxyz) and translation.

    Raises:
        InputError: the quaternion is not of unit length.
    """
    length = float(np.linalg.norm(row.rotation))
    if abs(length - 1.0) > _UNIT:
        problem = f"is not a rotation: the length of the quaternion is {length:.4g}, not 1"
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
        raise InputError(path, field, "is not a 3x3 matrix", _MEND)
    (fx, skew, cx), (lower, fy, cy), last = matrix
    if skew or lower or last != [0.0, 0.0, 1.0]:
        raise InputError(
            path, field, f"{matrix} is not the matrix of a pinhole camera without skew", _MEND
        )
    width, height = frames[0].width, frames[0].height
    for frame in frames:
        if (frame.width, frame.height) != (width, height):
            size, first = f"{frame.width}x{frame.height}", f"{width}x{height}"
            problem = f"are {size}, but the camera's first image is {first}"
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
class NuScenesSweeps(Timed):
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

    def __getitem__(self, index: int) -> LidarSweep:
        """Read sweep `index`.

        Raises:
            InputError: the file is empty, cut off or not finite.
        """
        path = self.paths[index]
        rows = read_points(path, POINT_FLOATS, slice(0, 3), [3], "download the file again")
        rows = rows[np.abs(rows[:, :2]).max(axis=1) > OWN_ROOF]
        points = se3.apply(self.rig_from_lidar, rows[:, :3]).astype(np.float32)
        return LidarSweep(int(self.timestamps_us[index]), points, unit_intensity(rows[:, 3]))


def read_ego(
    tables: Path, samples: Sequence[SampleRow], sensors: Sequence[Sensor]
) -> tuple[Trajectory, Array]:
    """The ego trajectory near the origin, and the offset taken off it.

    The dataset's ego frame has its origin on the ground under the rear axle, as our rig frame.

    Raises:
        InputError: poses are missing, broken, far apart in time, not all of one frame, or do not
            cover the frames.
    """
    frames = [frame for sensor in sensors for frame in sensor.frames]
    rows = linked(tables, "ego_pose", EgoPoseRow, frames, "sample_data", "ego_pose_token")
    path = tables / "ego_pose.json"
    ordered = sorted(rows.values(), key=lambda row: row.timestamp)
    if len({row.timestamp for row in ordered}) < 2:
        raise InputError(
            path, "rows", f"the scene has {len(ordered)} ego poses, 2 are needed", _MEND_POSES
        )
    placed = np.stack([pose_of(path, row) for row in ordered])
    all_times = np.array([row.timestamp for row in ordered], np.int64)
    jump = first_jump(all_times, placed)
    if jump is not None:
        problem = f"is {jump[1]:.0f} m from the pose before: mixed coordinate frames"
        raise InputError(path, f"token {ordered[jump[0]].token}: translation", problem, _MEND_POSES)
    times, first = np.unique(all_times, return_index=True)
    gaps = np.flatnonzero(np.diff(times) > LONGEST_GAP_US)
    if len(gaps):
        problem = f"the next pose is {(times[gaps[0] + 1] - times[gaps[0]]) / 1e6:.1f} s later"
        field = f"token {ordered[first[gaps[0]]].token}: timestamp"
        raise InputError(path, field, problem, "use a scene without the gap")
    poses = placed[first]
    offset: Array = poses[0, :3, 3].copy()
    poses[:, :3, 3] -= offset
    sensed = [frame.timestamp for frame in frames] + [sample.timestamp for sample in samples]
    trajectory = motion.extended(Trajectory(times, poses), min(sensed), max(sensed))
    for table, timed in (("sample", samples), ("sample_data", frames)):
        for row in timed:
            if not trajectory.covers(row.timestamp):
                problem = f"{row.timestamp} lies outside the scene's ego poses"
                where = tables / f"{table}.json"
                raise InputError(where, f"token {row.token}: timestamp", problem, _MEND_POSES)
    return trajectory, offset
