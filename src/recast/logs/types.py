"""A recorded drive as data: cameras, LiDAR, ego trajectory, tracks, map.

World frame: z up, metres, origin near the first ego pose. Rig frame: x forward, y left, z up,
origin at the rear axle on the ground. Timestamps are integer microseconds.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field
from pathlib import Path
from typing import Protocol, runtime_checkable

import numpy as np
from numpy.typing import ArrayLike

from recast.arrays import Array, Float32Array, Image, Int64Array, Mask
from recast.cameras import PinholeCamera
from recast.core.brief import Brief
from recast.geometry import se3
from recast.logs import checks
from recast.logs.hdmap import HdMap

FRAMES = ("world", "rig")
"""Names of coordinate frames, which sensors cannot have."""
VEHICLES = ("car", "van", "truck", "bus")
"""Categories of tracks that are motor vehicles with boxes of their own."""
PEOPLE = ("pedestrian", "cyclist")
"""Categories of tracks that are people, on foot or on bicycles."""


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
        hidden: rectangles (left, top, right, bottom) of frames, in pixels of the rectified image,
            that no street may be trained on; not stored with the log.
    """

    name: str
    camera: PinholeCamera
    rig_from_camera: Array
    timestamps_us: Int64Array
    images: ImageSource
    mask: Mask | None = None
    hidden: Mapping[int, tuple[float, float, float, float]] = field(default_factory=dict)


@dataclass(frozen=True)
class LidarSweep:
    """One turn of a LiDAR.

    Attributes:
        timestamp_us: time the points are referred to.
        points: (N, 3) float32 metres, rig frame at that time (ego motion during the turn undone).
        intensity: (N,) float32 in [0, 1]: a share of the dataset's scale if that has an end, else
            its hyperbolic tangent; 0 where the dataset has none.
        point_timestamps_us: (N,) int64, when each point was measured; None where all were measured
            (or are taken to have been measured) at `timestamp_us`.
    """

    timestamp_us: int
    points: Float32Array
    intensity: Float32Array
    point_timestamps_us: Int64Array | None = None

    def validate(self, where: str) -> None:
        """Raise ValueError naming the field of `where` at fault: its shape or range."""
        count = len(self.points)
        if self.points.shape != (count, 3):
            raise ValueError(f"{where}.points: expected (N, 3), got {self.points.shape}")
        checks.check_reach(f"{where}.points", self.points, checks.SENSOR_REACH)
        if self.intensity.shape != (count,) or not np.all(
            (self.intensity >= 0) & (self.intensity <= 1)
        ):
            raise ValueError(f"{where}.intensity: expected {count} values within [0, 1]")
        times = np.asarray(self.timestamp_us)[None]
        if self.point_timestamps_us is not None:
            if self.point_timestamps_us.shape != (count,):
                raise ValueError(f"{where}.point_timestamps_us: expected {count} times")
            times = np.append(self.point_timestamps_us, times)
        checks.check_time_range(f"{where}.timestamp_us", times)


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

    def validate(self, where: str) -> None:
        """Raise ValueError naming the field of `where` at fault."""
        checks.check_times(f"{where}.timestamps_us", self.timestamps_us)
        count = len(self.timestamps_us)
        if count == 0 or self.poses.shape != (count, 4, 4):
            needed = f"expected ({max(count, 1)}, 4, 4)"
            raise ValueError(f"{where}.poses: {needed}, got {self.poses.shape}")
        checks.check_poses(f"{where}.poses", self.poses, checks.WORLD_REACH)


@dataclass(frozen=True)
class Track:
    """One labelled object.

    Attributes:
        track_id: id of the track, unique in the log.
        category: lower case, one of "car", "van", "truck", "bus", "trailer", "pedestrian",
            "cyclist", "motorcyclist", "tram", "misc".
        size: (3,) length, width, height in metres.
        trajectory: `world_from_object`, origin at the box centre, x forward.
    """

    track_id: str
    category: str
    size: Array
    trajectory: Trajectory

    def validate(self, where: str) -> None:
        """Raise ValueError naming the field of `where` at fault."""
        checks.check_name(f"{where}.track_id", self.track_id)
        checks.check_name(f"{where}.category", self.category)
        least, most = checks.BOX_SIDE
        if self.size.shape != (3,) or not np.all((self.size >= least) & (self.size <= most)):
            raise ValueError(
                f"{where}.size: expected three sides of {least} to {most} m, got {self.size}"
            )
        self.trajectory.validate(where)


@dataclass(frozen=True, repr=False)
class DrivingLog(Brief):
    """A recorded drive.

    Attributes:
        name: name for people to read.
        cameras: camera streams by name.
        lidars: LiDAR streams by name.
        tracks: tracks by id.
        world_from_rig: ego trajectory; covers every camera, LiDAR and track timestamp.
        map: lanes and drivable area, or None.
        world_offset: (3,) float64, dataset coordinates = world coordinates + offset.
        metadata: source dataset, licence and the like, plain strings.
        origin: absolute path of the folder that `read_log` read it from, whose content it is; None
            for any other log. It is not compared and not written. A log that is made from this one
            (`dataclasses.replace`) has none, whatever was changed.
    """

    name: str
    cameras: Mapping[str, CameraStream]
    lidars: Mapping[str, LidarStream]
    world_from_rig: Trajectory
    tracks: Mapping[str, Track]
    map: HdMap | None = None
    world_offset: Array = field(default_factory=lambda: np.zeros(3))
    metadata: Mapping[str, str] = field(default_factory=dict)
    origin: Path | None = field(default=None, init=False, compare=False)

    def _facts(self) -> Mapping[str, object]:
        times = self.world_from_rig.timestamps_us
        return {
            "name": self.name,
            "seconds": f"{(times[-1] - times[0]) / 1e6:.1f}",
            **{kind: len(getattr(self, kind)) for kind in ("cameras", "lidars", "tracks")},
            "map": "no" if self.map is None else "derived" if self.map.derived else "yes",
        }

    def validate(self) -> None:
        """Raise ValueError naming the field at fault: shape, order, range, rotation, name.

        Images and sweeps are not read; see `LidarSweep.validate`.
        """
        checks.check_text("name", self.name)
        for key, text in self.metadata.items():
            checks.check_name("metadata", key)
            checks.check_text(f"metadata[{key!r}]", text)
        if self.world_offset.shape != (3,) or not np.all(np.isfinite(self.world_offset)):
            raise ValueError(
                f"world_offset: expected three finite numbers in metres, got {self.world_offset}"
            )
        self.world_from_rig.validate("world_from_rig")
        if len(self.world_from_rig.timestamps_us) < 2:
            raise ValueError("world_from_rig: at least two poses are needed")
        for name, stream in self.cameras.items():
            where = f"cameras[{name!r}]"
            self._check_sensor(where, name, stream, stream.rig_from_camera, len(stream.images))
            stream.camera.validate()
            shape = (stream.camera.height, stream.camera.width)
            if stream.mask is not None and (
                stream.mask.shape != shape or stream.mask.dtype != np.bool_
            ):
                found = f"{stream.mask.shape} {stream.mask.dtype}"
                raise ValueError(f"{where}.mask: expected {shape} bool, got {found}")
        for name, lidar in self.lidars.items():
            where = f"lidars[{name!r}]"
            self._check_sensor(where, name, lidar, lidar.rig_from_lidar, len(lidar.sweeps))
            if name in self.cameras:
                raise ValueError(f"{where}: a camera has the same name")
        for key, track in self.tracks.items():
            track.validate(f"tracks[{key!r}]")
            if track.track_id != key:
                raise ValueError(
                    f"tracks[{key!r}].track_id: is {track.track_id!r}, not the track's key"
                )
            self._check_covered(f"tracks[{key!r}]", track.trajectory.timestamps_us)
        if self.map is not None:
            self.map.validate()

    def _check_sensor(
        self, where: str, key: str, stream: CameraStream | LidarStream, mount: Array, frames: int
    ) -> None:
        checks.check_name(where, key)
        if stream.name != key:
            raise ValueError(f"{where}.name: is {stream.name!r}, not the sensor's key")
        if key in FRAMES:
            raise ValueError(f"{where}: a sensor cannot be called {' or '.join(FRAMES)}")
        checks.check_poses(f"{where}: mounting", mount, checks.SENSOR_REACH)
        if mount.shape != (4, 4):
            raise ValueError(f"{where}: mounting: expected (4, 4), got {mount.shape}")
        times = stream.timestamps_us
        checks.check_times(f"{where}.timestamps_us", times)
        if frames != len(times):
            raise ValueError(f"{where}: has {frames} frames for {len(times)} timestamps")
        self._check_covered(f"{where}.timestamps_us", times)

    def _check_covered(self, where: str, timestamps_us: Int64Array) -> None:
        first, last = self.world_from_rig.timestamps_us[[0, -1]]
        if len(timestamps_us) and not (first <= timestamps_us[0] and timestamps_us[-1] <= last):
            raise ValueError(f"{where}: outside the ego trajectory [{first}, {last}] us")
