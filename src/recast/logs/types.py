"""A recorded drive as data: cameras, LiDAR, ego trajectory, tracks, map.

World frame: z up, metres, origin near the first ego pose. Rig frame: x forward, y left, z up,
origin at the rear axle on the ground. Timestamps are integer microseconds.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field
from typing import Protocol, runtime_checkable

import numpy as np
from numpy.typing import ArrayLike, NDArray

from recast.geometry import PinholeCamera, se3
from recast.logs.hdmap import HdMap

Array = NDArray[np.float64]
Int64Array = NDArray[np.int64]
Float32Array = NDArray[np.float32]
Image = NDArray[np.uint8]
Mask = NDArray[np.bool_]


class ImageSource(Protocol):
    """Frames read on demand: index to (height, width, 3) uint8 RGB."""

    def __len__(self) -> int:
        """Number of frames."""

    def __getitem__(self, index: int, /) -> Image:
        """Decode frame `index`."""


@runtime_checkable
class EncodedImageSource(ImageSource, Protocol):
    """Frames that exist as files already: the store keeps their bytes instead of encoding anew."""

    def encoded(self, index: int) -> tuple[bytes, str]:
        """The bytes of frame `index` and their format, "png" or "jpeg"."""


class SweepSource(Protocol):
    """LiDAR sweeps read on demand."""

    def __len__(self) -> int:
        """Number of sweeps."""

    def __getitem__(self, index: int, /) -> LidarSweep:
        """Decode sweep `index`."""


@dataclass(frozen=True)
class CameraStream:
    """One camera of the rig.

    Attributes:
        name: the sensor's name in the log.
        camera: intrinsics; images are as the intrinsics say (distortion zero means rectified).
        rig_from_camera: (4, 4) OpenCV camera frame to rig.
        timestamps_us: (F,) int64, strictly increasing.
        images: F lazy frames (height, width, 3) uint8 RGB.
        mask: (height, width) bool, False where the image is never usable (ego body), or None.
    """

    name: str
    camera: PinholeCamera
    rig_from_camera: Array
    timestamps_us: Int64Array
    images: ImageSource
    mask: Mask | None = None


@dataclass(frozen=True)
class LidarSweep:
    """One turn of a LiDAR.

    Attributes:
        timestamp_us: time the points are referred to.
        points: (N, 3) float32 metres, rig frame at that time (ego motion during the turn undone).
        intensity: (N,) float32 in [0, 1].
        point_timestamps_us: (N,) int64, when each point was measured; None where all were measured
            (or are taken to have been measured) at `timestamp_us`.
    """

    timestamp_us: int
    points: Float32Array
    intensity: Float32Array
    point_timestamps_us: Int64Array | None = None


@dataclass(frozen=True)
class LidarStream:
    """One LiDAR of the rig; sweeps may be missing, so its times are its own.

    Attributes:
        rig_from_lidar: (4, 4).
        timestamps_us: (S,) int64, strictly increasing.
        sweeps: S lazy sweeps.
    """

    name: str
    rig_from_lidar: Array
    timestamps_us: Int64Array
    sweeps: SweepSource


@dataclass(frozen=True)
class Trajectory:
    """Timed poses.

    Attributes:
        timestamps_us: (T,) int64, strictly increasing.
        poses: (T, 4, 4) `world_from_body`.
    """

    timestamps_us: Int64Array
    poses: Array

    def at(self, timestamp_us: ArrayLike) -> Array:
        """Interpolated poses (..., 4, 4); raises ValueError outside the recorded interval."""
        return se3.interpolate(self.timestamps_us, self.poses, timestamp_us)

    def covers(self, timestamp_us: int) -> bool:
        """Whether `timestamp_us` lies within the recorded interval."""
        return bool(self.timestamps_us[0] <= timestamp_us <= self.timestamps_us[-1])


@dataclass(frozen=True)
class Track:
    """One labelled object.

    Attributes:
        track_id: unique in the log.
        category: lower case, one of "car", "van", "truck", "bus", "pedestrian", "cyclist", "tram",
            "misc".
        size: (3,) length, width, height in metres.
        trajectory: `world_from_object`, origin at the box centre, x forward.
    """

    track_id: str
    category: str
    size: Array
    trajectory: Trajectory


@dataclass(frozen=True)
class DrivingLog:
    """A recorded drive.

    Attributes:
        name: for people.
        cameras, lidars, tracks: by name or id.
        world_from_rig: ego trajectory; covers every camera, LiDAR and track timestamp.
        map: lanes and drivable area, or None.
        world_offset: (3,) float64, dataset coordinates = world coordinates + offset.
        metadata: source dataset, licence and the like, plain strings.
    """

    name: str
    cameras: Mapping[str, CameraStream]
    lidars: Mapping[str, LidarStream]
    world_from_rig: Trajectory
    tracks: Mapping[str, Track]
    map: HdMap | None = None
    world_offset: Array = field(default_factory=lambda: np.zeros(3))
    metadata: Mapping[str, str] = field(default_factory=dict)

    def validate(self) -> None:
        """Raise ValueError naming the field and the shape at fault."""
        _check_trajectory("world_from_rig", self.world_from_rig)
        for name, stream in self.cameras.items():
            where = f"cameras[{name!r}]"
            stream.camera.validate()
            _check_pose(f"{where}.rig_from_camera", stream.rig_from_camera)
            _check_times(f"{where}.timestamps_us", stream.timestamps_us)
            if len(stream.images) != len(stream.timestamps_us):
                raise ValueError(
                    f"{where}.images: {len(stream.images)} frames for "
                    f"{len(stream.timestamps_us)} timestamps"
                )
            shape = (stream.camera.height, stream.camera.width)
            if stream.mask is not None and stream.mask.shape != shape:
                raise ValueError(f"{where}.mask: shape {stream.mask.shape}, expected {shape}")
            self._check_covered(f"{where}.timestamps_us", stream.timestamps_us)
        for name, lidar in self.lidars.items():
            where = f"lidars[{name!r}]"
            _check_pose(f"{where}.rig_from_lidar", lidar.rig_from_lidar)
            _check_times(f"{where}.timestamps_us", lidar.timestamps_us)
            if len(lidar.sweeps) != len(lidar.timestamps_us):
                raise ValueError(
                    f"{where}.sweeps: {len(lidar.sweeps)} for {len(lidar.timestamps_us)} timestamps"
                )
            self._check_covered(f"{where}.timestamps_us", lidar.timestamps_us)
        for key, track in self.tracks.items():
            where = f"tracks[{key!r}]"
            if track.track_id != key:
                raise ValueError(f"{where}.track_id: is {track.track_id!r}, its key {key!r}")
            if track.size.shape != (3,) or not np.all(track.size > 0):
                raise ValueError(f"{where}.size: three positive metres, got {track.size}")
            _check_trajectory(where, track.trajectory)
            self._check_covered(f"{where}.timestamps_us", track.trajectory.timestamps_us)

    def _check_covered(self, where: str, timestamps_us: Int64Array) -> None:
        first, last = self.world_from_rig.timestamps_us[[0, -1]]
        if len(timestamps_us) and not (first <= timestamps_us[0] and timestamps_us[-1] <= last):
            raise ValueError(f"{where}: outside the ego trajectory [{first}, {last}] us")


def _check_times(where: str, timestamps_us: Int64Array) -> None:
    if timestamps_us.ndim != 1 or timestamps_us.dtype != np.int64:
        raise ValueError(
            f"{where}: expected (T,) int64, got {timestamps_us.shape} {timestamps_us.dtype}"
        )
    if np.any(np.diff(timestamps_us) <= 0):
        raise ValueError(f"{where}: must increase strictly")


def _check_pose(where: str, pose: Array) -> None:
    if pose.shape[-2:] != (4, 4):
        raise ValueError(f"{where}: expected (..., 4, 4), got {pose.shape}")
    rotation = pose[..., :3, :3]
    if not np.allclose(rotation @ np.swapaxes(rotation, -1, -2), np.eye(3), atol=1e-5):
        raise ValueError(f"{where}: the upper left 3x3 block is not a rotation")


def _check_trajectory(where: str, trajectory: Trajectory) -> None:
    _check_times(f"{where}.timestamps_us", trajectory.timestamps_us)
    if trajectory.poses.shape != (len(trajectory.timestamps_us), 4, 4):
        raise ValueError(
            f"{where}.poses: expected ({len(trajectory.timestamps_us)}, 4, 4), "
            f"got {trajectory.poses.shape}"
        )
    _check_pose(f"{where}.poses", trajectory.poses)
