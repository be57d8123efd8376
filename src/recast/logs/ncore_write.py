"""The NCore V4 stores of a log folder: written, checked and opened.

The files are foreign, and NCore trusts them. A store is a tar file of zarr arrays with a compressed
index at its end. Zarr allocates whatever shape is written there, fills in chunks that are missing,
and decodes with whatever codec is named; numcodecs has one of Python's pickle, which runs code, and
only new versions of it refuse that. So index and metadata are read here first, and what NCore and
the libraries below it raise for the rest becomes one line.
"""

from __future__ import annotations

import functools
import io
import json
import lzma
import math
import os
import re
import struct
from collections.abc import Hashable, Iterator, Mapping
from contextlib import contextmanager, suppress
from dataclasses import dataclass
from pathlib import Path
from typing import Any, BinaryIO, TypeVar, cast

import cbor2
import numpy as np
from ncore.data import (
    BBox3,
    CuboidTrackObservation,
    LabelSource,
    OpenCVPinholeCameraModelParameters,
    ShutterType,
)
from ncore.data.v4 import (
    CameraSensorComponent,
    ComponentReader,
    CuboidsComponent,
    IntrinsicsComponent,
    LidarSensorComponent,
    MasksComponent,
    PosesComponent,
    SequenceComponentGroupsReader,
    SequenceComponentGroupsWriter,
)
from ncore.impl.common.transformations import HalfClosedInterval  # which has no public name
from numcodecs import blosc  # type: ignore[import-untyped]
from PIL import Image as PillowImage
from scipy.spatial.transform import Rotation
from upath import UPath

from recast.cameras import PinholeCamera
from recast.core import files
from recast.core.diagnostics import Progress
from recast.core.errors import InputError
from recast.core.files import disk_errors, folder_name
from recast.geometry import se3
from recast.logs import motion
from recast.logs.checks import refused
from recast.logs.types import (
    Array,
    CameraStream,
    DrivingLog,
    EncodedImageSource,
    Float32Array,
    LidarStream,
    LidarSweep,
    Mask,
    Trajectory,
)

BLOCK = 512  # bytes; the last one begins with the header
HEADER = struct.Struct("<4sIQI")  # magic, type, offset and size of the index
BLOSC = struct.Struct("<4xI4xI")  # of its header: bytes unpacked and packed
METADATA = ".zmetadata.cbor.xz"
INDEX_LIMIT = 1 << 28
"""Bytes of index and of metadata, unpacked: a drive of hours has less."""
UNPACKING_MEMORY = 1 << 26
"""Bytes that unpacking may take beside that; what is written takes 9 MB."""
ARRAY_LIMIT = 1 << 28
"""Bytes of one array: an encoded image, or one quantity of the points of a sweep."""
_RATIO = 256  # LZ4 packs no better than 255 to 1
_DTYPE = re.compile(r"[<>|]([biuf][1248]|S[1-9]\d{0,9})")
Reader = TypeVar("Reader")
MEND = "import the drive again"


@contextmanager
def readable(path: Path, field: str) -> Iterator[None]:
    """Turn whatever goes wrong with a store's contents inside the block into one clear line."""
    try:
        yield
    except InputError:
        raise
    except (
        Exception
    ) as error:  # zarr, cbor, lzma, Blosc, numpy and NCore each raise their own kinds
        reason = str(error) or type(error).__name__
        raise InputError(path, field, f"cannot be read ({reason})", MEND) from error


@dataclass(frozen=True)
class NcoreFolder:
    """An NCore V4 store in a folder; cheap to copy into another process."""

    folder: Path  # folder that holds ncore.json and the stores it lists

    @property
    def listing(self) -> Path:
        """The file that names the stores."""
        return self.folder / SEQUENCE_FILE

    def check(self) -> None:
        """Open every store. Raises InputError: ncore.json or a store it lists is missing or
        broken."""
        self._open()

    def has(self, kind: type[Any], name: str) -> bool:
        """Whether there is a component of this kind and instance name."""
        return name in _open_components(self._open(), cast(Hashable, kind))

    def component(self, kind: type[Reader], name: str) -> Reader:
        """The component reader of this kind and instance name. Raises InputError: there is none."""
        field = f"{kind.__qualname__.split('.')[0]} {name!r}"
        with readable(self.listing, field):
            components = _open_components(self._open(), cast(Hashable, kind))
        if name not in components:
            raise InputError(self.listing, field, "is missing from the stores", MEND)
        return cast(Reader, components[name])

    def _open(self) -> SequenceComponentGroupsReader:
        with files.disk_errors(self.listing):
            status = self.listing.stat()
        # Open files cannot be shared with a forked process, nor with a folder written anew.
        return _open(self.folder, os.getpid(), status.st_ino, status.st_mtime_ns)


@functools.lru_cache(maxsize=4)
def _open(folder: Path, pid: int, inode: int, changed: int) -> SequenceComponentGroupsReader:
    listing = folder / SEQUENCE_FILE
    field = "component_stores"
    with readable(listing, field):
        listed = [store["path"] for store in files.read_json(listing)[field]]
    if not listed or not all(isinstance(name, str) for name in listed):
        raise InputError(listing, field, "lists no files", MEND)
    if len(set(listed)) != len(listed):
        raise InputError(listing, field, "lists a store twice", MEND)
    paths = [files.member(folder, name, listing, field) for name in listed]
    for path in paths:
        with readable(path, "NCore store"):
            check_store(path)
    with readable(listing, "NCore stores"):
        return SequenceComponentGroupsReader(paths, max_threads=1)


@functools.lru_cache(maxsize=64)
def _open_components(reader: SequenceComponentGroupsReader, kind: Hashable) -> dict[str, Any]:
    return dict(reader.open_component_readers(cast(Any, kind)))


def check_store(path: Path) -> None:
    """Check index and metadata of a store file; arrays themselves are not read.

    Raises:
        InputError: the disk refuses (see `files.disk_errors`).
        ValueError: anything in it is not as NCore writes it. Damaged files also raise what lzma and
            cbor2 raise.
    """
    with disk_errors(path), path.open("rb") as file:
        records = _index(file, path.stat().st_size)
        offset, size = records[METADATA]
        file.seek(offset)
        document = _unpacked(file.read(size))
        metadata = document.get("metadata") if isinstance(document, dict) else None
        if not isinstance(metadata, dict) or not all(
            isinstance(v, dict) for v in metadata.values()
        ):
            raise ValueError("its metadata is not an object of objects")
        for key, array in metadata.items():
            if key.endswith(".zarray"):
                _check_array(file, key.removesuffix(".zarray"), array, records)


def _index(file: BinaryIO, size: int) -> dict[str, tuple[int, int]]:
    """Offset and size of every member of the tar file, by name."""
    if size < BLOCK:
        raise ValueError("is too short")
    file.seek(size - BLOCK)
    magic, kind, offset, packed = HEADER.unpack(file.read(HEADER.size))
    if (magic, kind) != (b"itar", 1) or offset + packed > size:
        raise ValueError("does not end with an index: it was cut off, or is another kind of file")
    file.seek(offset)
    table = _unpacked(file.read(packed))
    names, offsets, sizes = (table[key] for key in ("items", "offset_datas", "sizes"))
    if not len(names) == len(offsets) == len(sizes) or len(set(names)) != len(names):
        raise ValueError("its index is inconsistent")
    for begin, length in zip(offsets, sizes, strict=True):
        if not (type(begin) is type(length) is int and begin >= 0 <= length):
            raise ValueError("its index is inconsistent")
        if begin + length > size:
            raise ValueError("its index leads beyond its end")
    return dict(zip(names, zip(offsets, sizes, strict=True), strict=True))


def _unpacked(data: bytes) -> Any:
    unpacker = lzma.LZMADecompressor(memlimit=UNPACKING_MEMORY)
    raw = unpacker.decompress(data, max_length=INDEX_LIMIT)
    if not unpacker.eof:
        raise ValueError(f"its index is cut off, or unpacks to more than {INDEX_LIMIT} bytes")
    return cbor2.loads(raw)


def _check_array(
    file: BinaryIO,
    name: str,
    array: Mapping[str, Any],
    records: Mapping[str, tuple[int, int]],
) -> None:
    """Check that an array is of plain numbers or bytes, whole in one chunk, and of bounded size."""
    dtype, shape, codec = array["dtype"], array["shape"], array["compressor"]
    if not (isinstance(dtype, str) and _DTYPE.fullmatch(dtype)):
        raise ValueError(f"array {name} has type {dtype!r}")
    if array["filters"] or not (codec is None or codec["id"] == "blosc"):
        raise ValueError(f"array {name} is encoded as {codec!r}, {array['filters']!r}")
    if not all(type(n) is int and n >= 0 for n in shape) or len(shape) > 4:
        raise ValueError(f"array {name} has shape {shape!r}")
    if list(array["chunks"]) != [max(n, 1) for n in shape]:
        raise ValueError(f"array {name} is not stored in one piece")
    size = np.dtype(dtype).itemsize * math.prod(shape)
    offset, stored = records.get(name + (".".join("0" * len(shape)) or "0"), (0, 0))
    unpacked = stored
    if codec is not None and stored >= BLOSC.size:
        file.seek(offset)
        unpacked, packed = BLOSC.unpack(file.read(BLOSC.size))
        unpacked = unpacked if packed == stored else -1
    if size != unpacked or size > min(ARRAY_LIMIT, _RATIO * stored):
        raise ValueError(f"array {name} of {size} bytes does not match its {stored} stored ones")


# Writing a log's sensors, poses and boxes as an NCore V4 store (nvidia-ncore).
#
# Frame names: "world", "rig" and the sensors' own. NCore calls a pose by (source, target); it maps
# source to target, so our `world_from_rig` is its ("rig", "world"). Sensors' names become names of
# files and of nodes there, so any that are not plain are stored as `files.folder_name` makes them;
# log.json has the names themselves.

COMPONENT = "default"  # instance name NCore's own loader looks for
MASK = "unusable"  # nonzero where the image is never usable
REFERENCE = "reference_timestamp_us"
SEQUENCE_FILE = "ncore.json"


def stored_group(reader: ComponentReader) -> Any:
    """The zarr group of a component, for which NCore (19.8) has no public name.

    Its readers check types box by box, a millisecond each, and open images of any format.
    """
    return reader._group


def write_ncore(log: DrivingLog, folder: Path, progress: Progress) -> None:
    """Write the NCore V4 stores of `log` into `folder`, and ncore.json that lists them.

    Args:
        log: valid, but for its sweeps and images, which are checked as they are written.
        progress: called with the images and sweeps written so far, from 0, and with all there are.

    Raises:
        InputError: a sweep or image is not valid, or NCore cannot hold it.
    """
    with _repeatable_compression(), _open_writer(log, folder) as writer:
        try:
            stores = _write_stores(writer, log, progress)
        except AssertionError as error:  # NCore's own checks
            mend = "use a recording whose sensors agree on its times"
            raise InputError(f"log {log.name}", "NCore store", str(error), mend) from error
    _write_sequence_file(folder, stores)


@contextmanager
def _open_writer(log: DrivingLog, folder: Path) -> Iterator[SequenceComponentGroupsWriter]:
    """A writer whose files are closed at the end, whatever happens: NCore closes them only when
    all is well."""
    first, last = (int(t) for t in log.world_from_rig.timestamps_us[[0, -1]])
    writer = SequenceComponentGroupsWriter(
        output_dir_path=UPath(folder),
        store_base_name="log",
        sequence_id=log.name,
        sequence_timestamp_interval_us=HalfClosedInterval(first, last + 1),
        generic_meta_data={},
    )
    try:
        yield writer
    finally:
        for group, _ in writer._stores_rootgroups.values():
            with suppress(OSError):  # of a full disk, which was told already
                group.store.tar_file_object.close()


@contextmanager
def _repeatable_compression() -> Iterator[None]:
    """Several Blosc threads give other bytes from run to run; one gives the same."""
    before = blosc.use_threads
    blosc.use_threads = False
    try:
        yield
    finally:
        blosc.use_threads = before


def _write_stores(
    writer: SequenceComponentGroupsWriter, log: DrivingLog, progress: Progress
) -> list[str]:
    _write_poses(writer, log)
    _write_calibration(writer, log)
    _write_tracks(writer, log)
    total = sum(len(camera.timestamps_us) for camera in log.cameras.values())
    total += sum(len(lidar.timestamps_us) for lidar in log.lidars.values())
    progress(0, total)
    for done, _ in enumerate(_write_frames(writer, log), start=1):
        progress(done, total)
    return [store.name for store in writer.finalize()]


def _write_frames(writer: SequenceComponentGroupsWriter, log: DrivingLog) -> Iterator[None]:
    """Write images and sweeps, one at each step."""
    for camera in log.cameras.values():
        if len(camera.timestamps_us):  # NCore cannot read a camera without frames
            yield from _write_images(writer, camera)
    for lidar in log.lidars.values():
        yield from _write_sweeps(writer, lidar, log.world_from_rig)


def _write_poses(writer: SequenceComponentGroupsWriter, log: DrivingLog) -> None:
    poses = writer.register_component_writer(PosesComponent.Writer, COMPONENT)
    trajectory = log.world_from_rig
    poses.store_dynamic_pose(
        "rig", "world", trajectory.poses, trajectory.timestamps_us.astype(np.uint64)
    )
    offset = se3.from_rotation_translation(np.eye(3), log.world_offset)
    poses.store_static_pose("world", "world_global", offset)
    for name, camera in log.cameras.items():
        poses.store_static_pose(folder_name(name), "rig", camera.rig_from_camera)
    for name, lidar in log.lidars.items():
        poses.store_static_pose(folder_name(name), "rig", lidar.rig_from_lidar)


def _write_calibration(writer: SequenceComponentGroupsWriter, log: DrivingLog) -> None:
    intrinsics = writer.register_component_writer(IntrinsicsComponent.Writer, COMPONENT)
    masks = writer.register_component_writer(MasksComponent.Writer, COMPONENT)
    for name, stream in log.cameras.items():
        intrinsics.store_camera_intrinsics(folder_name(name), _ncore_camera(stream.camera))
        images = {} if stream.mask is None else {MASK: _mask_image(stream.mask)}
        masks.store_camera_masks(folder_name(name), images)


def _ncore_camera(camera: PinholeCamera) -> OpenCVPinholeCameraModelParameters:
    k1, k2, p1, p2, k3 = camera.distortion
    return OpenCVPinholeCameraModelParameters(
        resolution=np.array([camera.width, camera.height], np.uint64),
        shutter_type=ShutterType.GLOBAL,
        external_distortion_parameters=None,
        principal_point=np.array([camera.cx, camera.cy], np.float32),
        focal_length=np.array([camera.fx, camera.fy], np.float32),
        radial_coeffs=np.array([k1, k2, k3, 0, 0, 0], np.float32),
        tangential_coeffs=np.array([p1, p2], np.float32),
        thin_prism_coeffs=np.zeros(4, np.float32),
    )


def _mask_image(mask: Mask) -> PillowImage.Image:
    return PillowImage.fromarray(np.where(mask, 0, 255).astype(np.uint8))


def _write_tracks(writer: SequenceComponentGroupsWriter, log: DrivingLog) -> None:
    cuboids = writer.register_component_writer(CuboidsComponent.Writer, COMPONENT)
    observations = []
    for track in log.tracks.values():
        angles = Rotation.from_matrix(track.trajectory.poses[:, :3, :3]).as_euler("XYZ")
        for time, pose, rot in zip(
            track.trajectory.timestamps_us.tolist(), track.trajectory.poses, angles, strict=True
        ):
            box = BBox3(_triple(pose[:3, 3]), _triple(track.size), _triple(rot))
            observations.append(
                CuboidTrackObservation(
                    track_id=track.track_id,
                    class_id=track.category,
                    timestamp_us=time,
                    reference_frame_id="world",
                    reference_frame_timestamp_us=time,
                    bbox3=box,
                    source=LabelSource.EXTERNAL,
                )
            )
    cuboids.store_observations(observations)


def _triple(values: Array) -> tuple[float, float, float]:
    return (float(values[0]), float(values[1]), float(values[2]))


def _write_images(writer: SequenceComponentGroupsWriter, stream: CameraStream) -> Iterator[None]:
    name = folder_name(stream.name)
    frames = writer.register_component_writer(CameraSensorComponent.Writer, name, group_name=name)
    for index, time in enumerate(stream.timestamps_us):
        data, kind = _encoded(stream, index)
        frames.store_frame(data, kind, np.array([time, time], np.uint64), {}, {})
        yield


def _encoded(stream: CameraStream, index: int) -> tuple[bytes, str]:
    """The frame's own bytes where it has some, else a PNG: never a second lossy encoding."""
    if isinstance(stream.images, EncodedImageSource):
        return stream.images.encoded(index)
    image, camera = stream.images[index], stream.camera
    if image.shape != (camera.height, camera.width, 3) or image.dtype != np.uint8:
        raise InputError(
            f"cameras[{stream.name!r}]",
            f"images[{index}]",
            f"is {image.shape} {image.dtype}, not uint8 of {camera.width}x{camera.height}",
            "give images and intrinsics of the same size",
        )
    buffer = io.BytesIO()
    PillowImage.fromarray(image).save(buffer, format="png")
    return buffer.getvalue(), "png"


def _write_sweeps(
    writer: SequenceComponentGroupsWriter, lidar: LidarStream, world_from_rig: Trajectory
) -> Iterator[None]:
    name = folder_name(lidar.name)
    frames = writer.register_component_writer(LidarSensorComponent.Writer, name, group_name=name)
    lidar_from_rig = se3.inverse(lidar.rig_from_lidar)
    for index in range(len(lidar.timestamps_us)):
        sweep = lidar.sweeps[index]
        with refused("log", "import the drive from complete files"):
            sweep.validate(f"lidars[{lidar.name!r}].sweeps[{index}]")
            directions, distances = _rays(sweep, lidar_from_rig, world_from_rig)
        times = sweep.point_timestamps_us
        if times is None:
            times = np.full(len(distances), sweep.timestamp_us, np.int64)
        span = np.append(times, sweep.timestamp_us)
        frames.store_frame(
            direction=directions,
            timestamp_us=times.astype(np.uint64),
            model_element=None,
            distance_m=distances[None],
            intensity=sweep.intensity.astype(np.float32)[None],
            frame_timestamps_us=np.array([span.min(), span.max()], np.uint64),
            generic_data={},
            generic_meta_data={REFERENCE: int(sweep.timestamp_us)},
        )
        yield


def _rays(
    sweep: LidarSweep, lidar_from_rig: Array, world_from_rig: Trajectory
) -> tuple[Float32Array, Float32Array]:
    """Unit directions (N, 3) and distances (N,) as measured: sensor frame, not compensated."""
    points = sweep.points.astype(np.float64)
    if sweep.point_timestamps_us is not None:
        points = motion.distort(
            points, sweep.point_timestamps_us, world_from_rig, sweep.timestamp_us
        )
    points = se3.apply(lidar_from_rig, points)
    distances = np.linalg.norm(points, axis=1)
    at_sensor = distances == 0
    directions = points / np.where(at_sensor, 1.0, distances)[:, None]
    directions[at_sensor] = [1.0, 0.0, 0.0]
    return directions.astype(np.float32), distances.astype(np.float32)


def _write_sequence_file(folder: Path, stores: list[str]) -> None:
    reader = SequenceComponentGroupsReader([folder / name for name in stores], max_threads=1)
    meta = json.loads(json.dumps(reader.get_sequence_meta().to_dict()))
    meta["component_stores"].sort(key=lambda store: store["path"])
    files.write_json(folder / SEQUENCE_FILE, meta)
