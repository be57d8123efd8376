"""Reading an NCore V4 store back, images and sweeps on demand."""

from __future__ import annotations

import functools
import io
import os
from collections.abc import Hashable
from dataclasses import dataclass
from pathlib import Path
from typing import Any, TypeVar, cast

import numpy as np
from ncore.data.v4 import (
    CameraSensorComponent,
    CuboidsComponent,
    LidarSensorComponent,
    MasksComponent,
    PosesComponent,
    SequenceComponentGroupsReader,
)
from PIL import Image as PillowImage
from scipy.spatial.transform import Rotation

from recast import storage
from recast.errors import InputError
from recast.geometry import se3
from recast.logs import motion
from recast.logs.ncore_write import COMPONENT, MASK, REFERENCE, SEQUENCE_FILE
from recast.logs.types import Array, Image, Int64Array, LidarSweep, Mask, Track, Trajectory

Reader = TypeVar("Reader")


@dataclass(frozen=True)
class NcoreFolder:
    """An NCore V4 store in a folder; cheap to copy into another process.

    Attributes:
        folder: holds ncore.json and the stores it lists.
    """

    folder: Path

    def check(self) -> None:
        """Open every store.

        Raises:
            InputError: ncore.json or a store it lists is missing or broken.
        """
        self._open()

    def has(self, kind: type[Any], name: str) -> bool:
        """Whether there is a component of this kind and instance name."""
        return name in _open_components(self._open(), cast(Hashable, kind))

    def component(self, kind: type[Reader], name: str) -> Reader:
        """The component reader of this kind and instance name.

        Raises:
            InputError: there is none.
        """
        try:
            reader: Reader = _open_components(self._open(), cast(Hashable, kind))[name]
        except KeyError:
            raise InputError(
                self.folder / SEQUENCE_FILE,
                f"{kind.__qualname__.split('.')[0]} {name!r}",
                "is missing from the stores",
                "import the drive again",
            ) from None
        return reader

    def _open(self) -> SequenceComponentGroupsReader:
        path = self.folder / SEQUENCE_FILE
        if not path.is_file():
            raise InputError(path, "file", "is missing", "import the drive again")
        status = path.stat()
        # Open files cannot be shared with a forked process, nor with a folder written anew.
        return _open(self.folder, os.getpid(), status.st_ino, status.st_mtime_ns)


@functools.lru_cache(maxsize=4)
def _open(folder: Path, pid: int, inode: int, changed: int) -> SequenceComponentGroupsReader:
    listing = storage.read_json(folder / SEQUENCE_FILE)
    try:
        names = [store["path"] for store in listing["component_stores"]]
    except (KeyError, TypeError):
        raise InputError(
            folder / SEQUENCE_FILE, "component_stores", "is missing", "import the drive again"
        ) from None
    for name in names:
        if not (folder / name).is_file():
            raise InputError(folder / name, "file", "is missing", "import the drive again")
        try:
            SequenceComponentGroupsReader([folder / name], max_threads=1)
        except Exception as error:  # zarr, cbor and lzma each raise their own kinds
            raise InputError(
                folder / name,
                "NCore store",
                f"cannot be opened ({error})",
                "import the drive again",
            ) from error
    return SequenceComponentGroupsReader([folder / name for name in names], max_threads=1)


@functools.lru_cache(maxsize=64)
def _open_components(reader: SequenceComponentGroupsReader, kind: Hashable) -> dict[str, Any]:
    return dict(reader.open_component_readers(cast(Any, kind)))


@dataclass(frozen=True)
class StoredImages:
    """Encoded frames of one camera in a store; implements `EncodedImageSource`."""

    store: NcoreFolder
    camera: str
    frame_ids: tuple[int, ...]

    def __len__(self) -> int:
        """Number of frames."""
        return len(self.frame_ids)

    def __getitem__(self, index: int) -> Image:
        """Decode frame `index` to (height, width, 3) uint8 RGB."""
        data, kind = self.encoded(index)
        with PillowImage.open(io.BytesIO(data), formats=[kind]) as image:
            return np.array(image.convert("RGB"))

    def encoded(self, index: int) -> tuple[bytes, str]:
        """The bytes of frame `index` and their format."""
        reader = self.store.component(CameraSensorComponent.Reader, self.camera)
        frame = reader.get_frame_data(self.frame_ids[index])
        return bytes(frame.get_encoded_image_data()), frame.get_encoded_image_format()


@dataclass(frozen=True)
class StoredSweeps:
    """Sweeps of one LiDAR in a store, ego motion during the turn undone; a `SweepSource`."""

    store: NcoreFolder
    lidar: str
    frame_ids: tuple[int, ...]
    rig_from_lidar: Array
    world_from_rig: Trajectory

    def __len__(self) -> int:
        """Number of sweeps."""
        return len(self.frame_ids)

    def __getitem__(self, index: int) -> LidarSweep:
        """Decode sweep `index`."""
        reader = self.store.component(LidarSensorComponent.Reader, self.lidar)
        frame = self.frame_ids[index]
        reference = _reference_time(reader, frame)
        directions = reader.get_frame_ray_bundle_data(frame, "direction").astype(np.float64)
        distances = reader.get_frame_ray_bundle_return_data(frame, "distance_m", 0)
        intensity = reader.get_frame_ray_bundle_return_data(frame, "intensity", 0)
        measured = reader.get_frame_ray_bundle_data(frame, "timestamp_us").astype(np.int64)
        points = se3.apply(self.rig_from_lidar, directions * distances[:, None])
        times: Int64Array | None = None
        if np.any(measured != reference):
            times = measured
            points = motion.compensate(points, times, self.world_from_rig, reference)
        return LidarSweep(reference, points.astype(np.float32), intensity, times)


def read_trajectory(store: NcoreFolder) -> Trajectory:
    """The ego trajectory."""
    poses, times = store.component(PosesComponent.Reader, COMPONENT).get_dynamic_pose(
        "rig", "world"
    )
    return Trajectory(times.astype(np.int64), poses.astype(np.float64))


def read_mount(store: NcoreFolder, sensor: str) -> Array:
    """`rig_from_sensor` (4, 4).

    Raises:
        InputError: the store has no such sensor.
    """
    poses = store.component(PosesComponent.Reader, COMPONENT)
    try:
        return poses.get_static_pose(sensor, "rig").astype(np.float64)
    except KeyError:
        raise InputError(
            store.folder / SEQUENCE_FILE, f"pose of {sensor!r}", "is missing", "import it again"
        ) from None


def read_mask(store: NcoreFolder, camera: str) -> Mask | None:
    """The mask of usable pixels (height, width), or None."""
    masks = store.component(MasksComponent.Reader, COMPONENT)
    if MASK not in masks.get_camera_mask_names(camera):
        return None
    return np.asarray(masks.get_camera_mask_image(camera, MASK)) == 0


def read_images(store: NcoreFolder, camera: str) -> tuple[Int64Array, StoredImages]:
    """Frame timestamps (F,) and lazy frames of one camera; none where it has only calibration."""
    if not store.has(CameraSensorComponent.Reader, camera):
        return np.zeros(0, np.int64), StoredImages(store, camera, ())
    times = store.component(CameraSensorComponent.Reader, camera).frames_timestamps_us
    ends = times.reshape(-1, 2)[:, 1].astype(np.int64)
    return ends, StoredImages(store, camera, tuple(ends.tolist()))


def read_sweeps(
    store: NcoreFolder, lidar: str, rig_from_lidar: Array, world_from_rig: Trajectory
) -> tuple[Int64Array, StoredSweeps]:
    """Reference timestamps (S,) and lazy sweeps of one LiDAR."""
    reader = store.component(LidarSensorComponent.Reader, lidar)
    frames = tuple(reader.frames_timestamps_us.reshape(-1, 2)[:, 1].astype(np.int64).tolist())
    times = [_reference_time(reader, frame) for frame in frames]
    return (
        np.array(times, np.int64),
        StoredSweeps(store, lidar, frames, rig_from_lidar, world_from_rig),
    )


def _reference_time(reader: LidarSensorComponent.Reader, frame: int) -> int:
    return int(cast(int, reader.get_frame_generic_meta_data(frame)[REFERENCE]))


def read_tracks(store: NcoreFolder) -> dict[str, Track]:
    """All tracks, in the order in which they were written."""
    cuboids = store.component(CuboidsComponent.Reader, COMPONENT)
    # NCore's own get_observations checks types box by box: a millisecond each, and a city log has
    # 12,000. The stored records are the same.
    rows: dict[str, list[Any]] = {}
    for box in cuboids._group["cuboids"].attrs["cuboid_track_observations"]:
        rows.setdefault(box["track_id"], []).append(box)
    tracks = {}
    for track_id, boxes in rows.items():
        rotation = Rotation.from_euler("XYZ", [box["bbox3"]["rot"] for box in boxes]).as_matrix()
        centres = [box["bbox3"]["centroid"] for box in boxes]
        poses = se3.from_rotation_translation(rotation, centres)
        times = np.array([box["timestamp_us"] for box in boxes], np.int64)
        size = np.array(boxes[0]["bbox3"]["dim"], np.float64)
        tracks[track_id] = Track(track_id, boxes[0]["class_id"], size, Trajectory(times, poses))
    return tracks
