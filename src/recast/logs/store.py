"""Reading sensors, poses and boxes back from an NCore V4 store, images and sweeps on demand."""

from __future__ import annotations

from dataclasses import asdict, dataclass
from pathlib import Path
from typing import Any, Literal, cast

import numpy as np
from ncore.data.v4 import (
    CameraSensorComponent,
    CuboidsComponent,
    LidarSensorComponent,
    MasksComponent,
    PosesComponent,
)
from pydantic import field_validator
from scipy.spatial.transform import Rotation

from recast.cameras import PinholeCamera
from recast.core import files, records
from recast.core.arguments import checked
from recast.core.diagnostics import Progress
from recast.core.errors import InputError
from recast.core.images import decode_mask
from recast.geometry import se3
from recast.logs import checks, images, motion
from recast.logs.checks import refused
from recast.logs.hdmap import read_map, write_map
from recast.logs.ncore_write import (
    COMPONENT,
    MASK,
    REFERENCE,
    NcoreFolder,
    readable,
    stored_group,
    write_ncore,
)
from recast.logs.plausibility import require_plausible
from recast.logs.types import (
    Array,
    CameraStream,
    DrivingLog,
    Image,
    Int64Array,
    LidarStream,
    LidarSweep,
    Mask,
    Track,
    Trajectory,
)


@dataclass(frozen=True)
class StoredImages:
    """Encoded frames of one camera in a store; implements `EncodedImageSource`."""

    store: NcoreFolder
    camera: str  # the sensor's name
    size: tuple[int, int]  # width and height of every frame
    frame_ids: tuple[int, ...]

    def __len__(self) -> int:
        """Number of frames."""
        return len(self.frame_ids)

    def __getitem__(self, index: int) -> Image:
        """Decode frame `index` to (height, width, 3) uint8 RGB. Raises InputError: it is damaged,
        or has another size."""
        data, kind = self.encoded(index)
        where = f"{self.store.folder}: camera {self.camera}, frame {index}"
        return images.decode(data, kind, self.size, where, "log.json")

    def encoded(self, index: int) -> tuple[bytes, str]:
        """The bytes of frame `index` and their format. Raises InputError: they cannot be read."""
        reader = self.store.component(CameraSensorComponent.Reader, files.folder_name(self.camera))
        with readable(self.store.folder, f"camera {self.camera}, frame {index}"):
            frame = reader.get_frame_data(self.frame_ids[index])
            return bytes(frame.get_encoded_image_data()), str(frame.get_encoded_image_format())


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
        """Decode sweep `index`. Raises InputError: it is damaged."""
        reader = self.store.component(LidarSensorComponent.Reader, files.folder_name(self.lidar))
        with readable(self.store.folder, f"LiDAR {self.lidar}, sweep {index}"):
            sweep = self._decode(reader, self.frame_ids[index])
            sweep.validate("sweep")
        return sweep

    def _decode(self, reader: LidarSensorComponent.Reader, frame: int) -> LidarSweep:
        reference = _reference_time(reader, frame)
        directions = reader.get_frame_ray_bundle_data(frame, "direction").astype(np.float64)
        distances = reader.get_frame_ray_bundle_return_data(frame, "distance_m", 0)
        intensity = reader.get_frame_ray_bundle_return_data(frame, "intensity", 0)
        measured = reader.get_frame_ray_bundle_data(frame, "timestamp_us").astype(np.int64)
        kept = distances > checks.NEAREST_RETURN  # false for NaN; logs of other tools hold both
        directions, distances, measured = directions[kept], distances[kept], measured[kept]
        points = se3.apply(self.rig_from_lidar, directions * distances[:, None])
        times: Int64Array | None = None
        if np.any(measured != reference):
            times = measured
            points = motion.compensate(points, times, self.world_from_rig, reference)
        return LidarSweep(reference, points.astype(np.float32), intensity[kept], times)


def read_trajectory(store: NcoreFolder) -> Trajectory:
    """The ego trajectory, not validated. Raises InputError: there is none."""
    reader = store.component(PosesComponent.Reader, COMPONENT)
    with readable(store.folder, "ego trajectory"):
        poses, times = reader.get_dynamic_pose("rig", "world")
        return Trajectory(times.astype(np.int64), poses.astype(np.float64))


def read_camera(store: NcoreFolder, name: str, camera: PinholeCamera) -> CameraStream:
    """One camera with lazy frames; without any where the store has only its calibration.

    Args:
        camera: its intrinsics, validated.

    Raises:
        InputError: a part of it is missing or damaged.
    """
    times: Int64Array = np.zeros(0, np.int64)
    frames: tuple[int, ...] = ()
    stored = files.folder_name(name)
    with readable(store.folder, f"camera {name!r}"):
        if store.has(CameraSensorComponent.Reader, stored):
            reader = store.component(CameraSensorComponent.Reader, stored)
            times = reader.frames_timestamps_us.reshape(-1, 2)[:, 1].astype(np.int64)
            frames = tuple(times.tolist())
        size = (camera.width, camera.height)
        return CameraStream(
            name=name,
            camera=camera,
            rig_from_camera=_mount(store, stored),
            timestamps_us=times,
            images=StoredImages(store, name, size, frames),
            mask=_mask(store, stored, size),
        )


def _mount(store: NcoreFolder, stored: str) -> Array:
    """`rig_from_sensor` (4, 4) of the sensor that is stored under this name."""
    poses = store.component(PosesComponent.Reader, COMPONENT)
    return poses.get_static_pose(stored, "rig").astype(np.float64)


def _mask(store: NcoreFolder, stored: str, size: tuple[int, int]) -> Mask | None:
    """The mask of usable pixels (height, width), or None."""
    masks = store.component(MasksComponent.Reader, COMPONENT)
    if MASK not in masks.get_camera_mask_names(stored):
        return None
    data = bytes(stored_group(masks)["cameras"][stored][MASK][()])
    where = f"{store.folder}: mask of camera {stored}"
    mend = "import the log again"
    return decode_mask(data, where, size, "log.json", formats=("PNG",), mend=mend) <= 127


def read_lidar(store: NcoreFolder, name: str, world_from_rig: Trajectory) -> LidarStream:
    """One LiDAR with lazy sweeps. Raises InputError: a part of it is missing or damaged."""
    stored = files.folder_name(name)
    reader = store.component(LidarSensorComponent.Reader, stored)
    with readable(store.folder, f"LiDAR {name!r}"):
        frames = tuple(reader.frames_timestamps_us.reshape(-1, 2)[:, 1].astype(np.int64).tolist())
        times = np.array([_reference_time(reader, frame) for frame in frames], np.int64)
        mount = _mount(store, stored)
        sweeps = StoredSweeps(store, name, frames, mount, world_from_rig)
        return LidarStream(name, mount, times, sweeps)


def _reference_time(reader: LidarSensorComponent.Reader, frame: int) -> int:
    return int(cast(int, reader.get_frame_generic_meta_data(frame)[REFERENCE]))


def read_tracks(store: NcoreFolder) -> dict[str, Track]:
    """All tracks, in the order in which they were written; not validated. Raises InputError: a box
    is damaged."""
    cuboids = store.component(CuboidsComponent.Reader, COMPONENT)
    # NCore's own get_observations checks types box by box: a millisecond each, and a city log has
    # 12,000. The stored records are the same.
    rows: dict[str, list[Any]] = {}
    with readable(store.folder, "tracks"):
        for box in stored_group(cuboids)["cuboids"].attrs["cuboid_track_observations"]:
            rows.setdefault(box["track_id"], []).append(box)
        return {track_id: _track(track_id, boxes) for track_id, boxes in rows.items()}


def _track(track_id: str, boxes: list[Any]) -> Track:
    rotation = Rotation.from_euler("XYZ", [box["bbox3"]["rot"] for box in boxes]).as_matrix()
    centres = [box["bbox3"]["centroid"] for box in boxes]
    poses = se3.from_rotation_translation(rotation, centres)
    times = np.array([box["timestamp_us"] for box in boxes], np.int64)
    size = np.array(boxes[0]["bbox3"]["dim"], np.float64)
    return Track(track_id, boxes[0]["class_id"], size, Trajectory(times, poses))


VERSION = 1
LOG_FILE = "log.json"
MAP_FILE = "map.json"

WriteProgress = Progress
"""Called with the images and sweeps written so far, and with all there are."""


@checked()
def write_log(log: DrivingLog, path: str | Path, progress: WriteProgress | None = None) -> None:
    """Write `log` to the new folder `path`; it appears whole or not at all.

    One image or sweep at a time is in memory. Images that are PNG or JPEG files already keep their
    bytes, others become PNG. LiDAR points are stored as NCore wants them: rays in the sensor frame,
    as measured.

    Args:
        log: images and sweeps are read from their source now; its `origin` is not written.
        path: the folder; the one above it is made if it is missing.
        progress: called after each image or sweep, and once before the first.

    Raises:
        InputError: the log is not valid, no vehicle can have recorded it, one of its images or
            sweeps cannot be read, `path` exists, or the disk refuses.
    """
    require_plausible(log, f"log {log.name}", "correct the data from which the log was made")
    with files.atomic_folder(path) as folder:
        write_ncore(log, folder, progress or (lambda done, total: None))
        if log.map is not None:
            write_map(log.map, folder / MAP_FILE)
        x, y, z = (float(value) for value in log.world_offset)
        record = LogRecord(
            name=log.name,
            world_offset=(x, y, z),
            metadata=dict(log.metadata),
            cameras={name: CameraRecord(**asdict(c.camera)) for name, c in log.cameras.items()},
            lidars=list(log.lidars),
            has_map=log.map is not None,
        )
        files.write_json(folder / LOG_FILE, record.model_dump())


def read_log(path: str | Path) -> DrivingLog:
    """Read a log folder; images and sweeps are decoded when asked for.

    Returns:
        the log, with the folder's absolute path as its `origin`.

    Raises:
        InputError: no such folder, not a log, another version, a file of it missing or broken, or
            no vehicle can have recorded it (`recast.logs.plausibility`).
    """
    folder = Path(path).absolute()
    if not folder.is_dir():
        raise InputError(path, "log folder", "does not exist", "import a drive: recast log import")
    if not (folder / LOG_FILE).is_file():
        raise InputError(path, LOG_FILE, "is missing", "name a folder that recast log import wrote")
    record = records.read_record(
        folder / LOG_FILE,
        LogRecord,
        VERSION,
        "name a folder that recast log import wrote, or import again",
        "recast-log",
    )
    store = NcoreFolder(folder)
    store.check()
    world_from_rig = read_trajectory(store)
    cameras = {}
    for name, camera in record.cameras.items():
        with refused(folder / LOG_FILE, "import the drive again"):
            camera.camera().validate()  # before images and masks are as large as it says
        cameras[name] = read_camera(store, name, camera.camera())
    log = DrivingLog(
        name=record.name,
        cameras=cameras,
        lidars={n: read_lidar(store, n, world_from_rig) for n in record.lidars},
        world_from_rig=world_from_rig,
        tracks=read_tracks(store),
        map=read_map(folder / MAP_FILE) if record.has_map else None,
        world_offset=np.array(record.world_offset, np.float64),
        metadata=record.metadata,
    )
    require_plausible(log, path, "import the drive again")
    object.__setattr__(log, "origin", folder)  # no argument, so that `replace` drops it
    return log


class CameraRecord(records.Record):
    """Exact intrinsics of one camera; pixels, pixel centres at +0.5."""

    width: int
    height: int
    fx: float
    fy: float
    cx: float
    cy: float
    distortion: tuple[float, float, float, float, float]

    def camera(self) -> PinholeCamera:
        """The camera recorded."""
        return PinholeCamera(**self.model_dump())


class LogRecord(records.Record):
    """The contents of log.json."""

    format: Literal["recast-log"] = "recast-log"
    version: Literal[1] = 1
    name: str
    world_offset: tuple[float, float, float]
    metadata: dict[str, str]
    cameras: dict[str, CameraRecord]
    lidars: list[str]
    has_map: bool

    @field_validator("lidars")
    @classmethod
    def _different(cls, names: list[str]) -> list[str]:
        if len(set(names)) != len(names):
            raise ValueError("a name appears twice")
        return names
