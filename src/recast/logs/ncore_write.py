"""Writing a log's sensors, poses and boxes as an NCore V4 store (nvidia-ncore).

Frame names: "world", "rig" and the sensors' own. NCore calls a pose by (source, target); it maps
source to target, so our `world_from_rig` is its ("rig", "world").
"""

from __future__ import annotations

import io
import json
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from pathlib import Path

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
    CuboidsComponent,
    IntrinsicsComponent,
    LidarSensorComponent,
    MasksComponent,
    PosesComponent,
    SequenceComponentGroupsReader,
    SequenceComponentGroupsWriter,
)
from ncore.impl.common.transformations import HalfClosedInterval
from numcodecs import blosc  # type: ignore[import-untyped]
from PIL import Image as PillowImage
from scipy.spatial.transform import Rotation
from upath import UPath

from recast import storage
from recast.geometry import PinholeCamera, se3
from recast.logs import motion
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

COMPONENT = "default"  # instance name NCore's own loader looks for
MASK = "unusable"  # nonzero where the image is never usable
REFERENCE = "reference_timestamp_us"
SEQUENCE_FILE = "ncore.json"


def write_ncore(log: DrivingLog, folder: Path, progress: Callable[[int, int], None]) -> None:
    """Write the NCore V4 stores of `log` into `folder`, and ncore.json that lists them.

    Args:
        progress: called with the images and sweeps written so far, from 0, and with all there are.

    Raises:
        ValueError: the ego trajectory has fewer than two poses, or an intensity is outside [0, 1].
    """
    first, last = (int(t) for t in log.world_from_rig.timestamps_us[[0, -1]])
    if first == last:
        raise ValueError("world_from_rig: at least two poses are needed")
    with _repeatable_compression():
        stores = _write_stores(log, folder, HalfClosedInterval(first, last + 1), progress)
    _write_sequence_file(folder, stores)


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
    log: DrivingLog,
    folder: Path,
    interval: HalfClosedInterval,
    progress: Callable[[int, int], None],
) -> list[str]:
    writer = SequenceComponentGroupsWriter(
        output_dir_path=UPath(folder),
        store_base_name="log",
        sequence_id=log.name,
        sequence_timestamp_interval_us=interval,
        generic_meta_data={},
    )
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
        poses.store_static_pose(name, "rig", camera.rig_from_camera)
    for name, lidar in log.lidars.items():
        poses.store_static_pose(name, "rig", lidar.rig_from_lidar)


def _write_calibration(writer: SequenceComponentGroupsWriter, log: DrivingLog) -> None:
    intrinsics = writer.register_component_writer(IntrinsicsComponent.Writer, COMPONENT)
    masks = writer.register_component_writer(MasksComponent.Writer, COMPONENT)
    for name, stream in log.cameras.items():
        intrinsics.store_camera_intrinsics(name, _ncore_camera(stream.camera))
        images = {} if stream.mask is None else {MASK: _mask_image(stream.mask)}
        masks.store_camera_masks(name, images)


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
    frames = writer.register_component_writer(
        CameraSensorComponent.Writer, stream.name, group_name=stream.name
    )
    for index, time in enumerate(stream.timestamps_us):
        data, kind = _encoded(stream, index)
        frames.store_frame(data, kind, np.array([time, time], np.uint64), {}, {})
        yield


def _encoded(stream: CameraStream, index: int) -> tuple[bytes, str]:
    """The frame's own bytes where it has some, else a PNG: never a second lossy encoding."""
    if isinstance(stream.images, EncodedImageSource):
        return stream.images.encoded(index)
    buffer = io.BytesIO()
    PillowImage.fromarray(stream.images[index]).save(buffer, format="png")
    return buffer.getvalue(), "png"


def _write_sweeps(
    writer: SequenceComponentGroupsWriter, lidar: LidarStream, world_from_rig: Trajectory
) -> Iterator[None]:
    frames = writer.register_component_writer(
        LidarSensorComponent.Writer, lidar.name, group_name=lidar.name
    )
    lidar_from_rig = se3.inverse(lidar.rig_from_lidar)
    for index in range(len(lidar.timestamps_us)):
        sweep = lidar.sweeps[index]
        directions, distances = _rays(sweep, lidar_from_rig, world_from_rig)
        times = sweep.point_timestamps_us
        if times is None:
            times = np.full(len(distances), sweep.timestamp_us, np.int64)
        span = np.append(times, sweep.timestamp_us)
        if np.any((sweep.intensity < 0) | (sweep.intensity > 1)):
            raise ValueError(f"lidars[{lidar.name!r}].sweeps[{index}].intensity: outside [0, 1]")
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
    storage.write_json(folder / SEQUENCE_FILE, meta)
