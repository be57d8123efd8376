"""nuScenes scenes: calibration, images, sweeps, ego poses and boxes."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from itertools import pairwise
from pathlib import Path

import numpy as np

from recast.cameras import PinholeCamera
from recast.core.errors import InputError
from recast.core.files import member
from recast.geometry import se3
from recast.logs import checks, motion
from recast.logs.images import ImageFiles
from recast.logs.importers.common import (
    Timed,
    chosen_cameras,
    first_jump,
    read_points,
    returns_valid,
    unit_intensity,
    unknown_drive,
)
from recast.logs.importers.nuscenes_tables import (
    AnnotationRow,
    CalibratedSensorRow,
    CategoryRow,
    EgoPoseRow,
    InstanceRow,
    LogRow,
    SampleDataRow,
    SampleRow,
    SceneRow,
    SensorRow,
    linked,
    select,
)
from recast.logs.plausibility import turned_around
from recast.logs.types import (
    Array,
    CameraStream,
    DrivingLog,
    Int64Array,
    LidarStream,
    LidarSweep,
    Track,
    Trajectory,
)

POINT_FLOATS = 5  # x, y, z, intensity, ring
OWN_ROOF = 1.0
"""Metres beside the LiDAR within which it sees nothing but the roof it stands on."""
_UNIT = 1e-3
_MEND_FILE = "unpack the split's metadata archive again"
LONGEST_GAP_US = 1_000_000


@dataclass(frozen=True)
class Sensor:
    """A camera or LiDAR of a scene."""

    name: str
    kind: str  # "camera" or "lidar"
    mount: CalibratedSensorRow
    frames: list[SampleDataRow]  # frames in the order of time


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
    """The transform (4, 4) of a row's rotation (wxyz) and translation. Raises InputError: the
    quaternion is not of unit length."""
    length = float(np.linalg.norm(row.rotation))
    if abs(length - 1.0) > _UNIT:
        problem = f"is not a rotation: the length of the quaternion is {length:.4g}, not 1"
        raise InputError(path, f"token {row.token}: rotation", problem, _MEND_FILE)
    return se3.from_rotation_translation(se3.quat_to_matrix(row.rotation), row.translation)


def camera_of(tables: Path, row: CalibratedSensorRow, frames: list[SampleDataRow]) -> PinholeCamera:
    """Intrinsics of a camera whose images (undistorted by the dataset's makers) are `frames`.
    Raises InputError: the camera has no intrinsics or impossible ones, or its images differ in
    size."""
    path = tables / "calibrated_sensor.json"
    field = f"token {row.token}: camera_intrinsic"
    matrix = row.camera_intrinsic
    if not matrix:
        raise InputError(path, field, "is empty: a camera without calibration", _MEND_FILE)
    if [len(line) for line in matrix] != [3, 3, 3]:
        raise InputError(path, field, "is not a 3x3 matrix", _MEND_FILE)
    (fx, skew, cx), (lower, fy, cy), last = matrix
    if skew or lower or last != [0.0, 0.0, 1.0]:
        raise InputError(
            path, field, f"{matrix} is not the matrix of a pinhole camera without skew", _MEND_FILE
        )
    width, height = frames[0].width, frames[0].height
    for frame in frames:
        if (frame.width, frame.height) != (width, height):
            size, first = f"{frame.width}x{frame.height}", f"{width}x{height}"
            problem = f"are {size}, but the camera's first image is {first}"
            raise InputError(
                tables / "sample_data.json",
                f"token {frame.token}: width, height",
                problem,
                _MEND_FILE,
            )
    # Projection in the dataset's own tools counts pixel centres from 0, we from 0.5.
    camera = PinholeCamera(width, height, fx, fy, cx + 0.5, cy + 0.5)
    try:
        camera.validate()
    except ValueError as error:
        raise InputError(path, field, str(error), _MEND_FILE) from None
    return camera


@dataclass(frozen=True)
class NuScenesSweeps(Timed):
    """Sweeps read from .pcd.bin files on demand; a `SweepSource`.

    Points are in the sensor's frame at the sweep's time, ego motion undone by the dataset's makers
    (Caesar et al., CVPR 2020), so no point has a time of its own.
    """

    timestamps_us: Int64Array  # (S,) int64
    paths: tuple[Path, ...]  # S files of float32 x, y, z (metres), intensity (0 to 255), ring
    rig_from_lidar: Array  # (4, 4)

    def __getitem__(self, index: int) -> LidarSweep:
        """Read sweep `index`. Raises InputError: the file is empty, cut off or not finite."""
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
            path, "rows", f"the scene has {len(ordered)} ego poses, 2 are needed", _MEND
        )
    placed = np.stack([pose_of(path, row) for row in ordered])
    all_times = np.array([row.timestamp for row in ordered], np.int64)
    jump = first_jump(all_times, placed)
    if jump is not None:
        problem = f"is {jump[1]:.0f} m from the pose before: mixed coordinate frames"
        raise InputError(path, f"token {ordered[jump[0]].token}: translation", problem, _MEND)
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
                raise InputError(where, f"token {row.token}: timestamp", problem, _MEND)
    return trajectory, offset


# nuScenes scenes: poses, boxes, LiDAR and cameras of the JSON tables as a driving log.
#
# Source: Caesar et al., "nuScenes: A multimodal dataset for autonomous driving" (CVPR 2020), and
# the dataset's published schema.

EGO = "vehicle.ego"
CATEGORIES = {
    "animal": "misc",
    "human.pedestrian.adult": "pedestrian",
    "human.pedestrian.child": "pedestrian",
    "human.pedestrian.construction_worker": "pedestrian",
    "human.pedestrian.personal_mobility": "cyclist",
    "human.pedestrian.police_officer": "pedestrian",
    "human.pedestrian.stroller": "pedestrian",
    "human.pedestrian.wheelchair": "pedestrian",
    "movable_object.barrier": "misc",
    "movable_object.debris": "misc",
    "movable_object.pushable_pullable": "misc",
    "movable_object.trafficcone": "misc",
    "static_object.bicycle_rack": "misc",
    "vehicle.bicycle": "cyclist",
    "vehicle.bus.bendy": "bus",
    "vehicle.bus.rigid": "bus",
    "vehicle.car": "car",
    "vehicle.construction": "truck",
    "vehicle.emergency.ambulance": "van",
    "vehicle.emergency.police": "car",
    "vehicle.motorcycle": "motorcyclist",
    "vehicle.trailer": "trailer",
    "vehicle.truck": "truck",
}
"""The dataset's categories; the ego's own box, should there be one, is left out."""

STEPS = 5
"""Poses for each interval of two key frames: ten a second, as other datasets label. What uses boxes
takes sweeps far from every label as unlabelled."""

_TABLE = "sample_annotation"
_FARTHEST = 500.0
"""Metres from the ego: no LiDAR sees farther, so such a box is of another place or frame."""
_MEND = "use tables of the same metadata archive"
LICENCE = "CC BY-NC-SA 4.0"
KEY_FRAMES = "key_frames_us"
"""Member of the metadata that has the times of the key frames, in order, with blanks between."""


@returns_valid
def load_nuscenes(
    root: Path, drive: str, labels: Path | None = None, cameras: Sequence[str] = ()
) -> DrivingLog:
    """Read a nuScenes scene, without a map; images and sweeps are decoded when asked for.

    Args:
        root: the dataset's folder, which holds v1.0-mini, v1.0-trainval or v1.0-test, samples and
            sweeps. Sensors without files in sweeps have key frames only. log.json may be missing.
        drive: the scene's name, such as scene-0061.
        labels: must be None, since the tables hold the boxes.
        cameras: names of the cameras to read, such as CAM_FRONT; all if empty. The files of
            others need not be there.

    Raises:
        InputError: tables or files are missing, broken or do not belong together.
    """
    if labels is not None:
        raise InputError(
            labels, "labels", "are already in the nuScenes tables", "leave the option out"
        )
    root = Path(root)
    tables, scene = _find_scene(root, drive)
    where = {}
    if (tables / "log.json").is_file():
        recording = linked(tables, "log", LogRow, [scene], "scene", "log_token")[scene.log_token]
        where = {
            "location": recording.location,
            "date": recording.date_captured,
            "vehicle": recording.vehicle,
        }
    samples = select(tables / "sample.json", SampleRow, "scene_token", {scene.token})
    sensors = read_sensors(root, tables, samples, cameras)
    mounted = [sensor.name for sensor in sensors if sensor.kind == "camera"]
    chosen = chosen_cameras(root / drive, mounted, cameras)
    trajectory, offset = read_ego(tables, samples, sensors)
    # Before poses are interpolated: between flipped headings they would spin.
    tracks, notes = turned_around(read_key_tracks(tables, samples, trajectory, offset))
    key_frames = sorted(sample.timestamp for sample in samples)
    return DrivingLog(
        name=scene.name,
        cameras={s.name: _camera(root, tables, s) for s in sensors if s.name in chosen},
        lidars={s.name: _lidar(root, tables, s) for s in sensors if s.kind == "lidar"},
        world_from_rig=trajectory,
        tracks={token: _filled(track, key_frames) for token, track in tracks.items()},
        world_offset=offset,
        metadata={
            "dataset": f"nuScenes {tables.name}",
            "drive": scene.name,
            **where,
            "licence": LICENCE,
            KEY_FRAMES: " ".join(map(str, key_frames)),
            **notes,
        },
    )


def _find_scene(root: Path, drive: str) -> tuple[Path, SceneRow]:
    if not root.is_dir():
        raise InputError(root, "nuScenes folder", "does not exist", "check the path")
    versions = sorted(path for path in root.glob("v1.0-*") if path.is_dir())
    if not versions:
        mend = "name the folder that holds v1.0-mini or v1.0-trainval, samples and sweeps"
        raise InputError(root, "v1.0-*", "has no folder of tables", mend)
    names = []
    for tables in versions:
        for scene in select(tables / "scene.json", SceneRow):
            if scene.name == drive:
                return tables, scene
            names.append(scene.name)
    raise unknown_drive(root, drive, names, "use a metadata archive that contains scenes")


def _camera(root: Path, tables: Path, sensor: Sensor) -> CameraStream:
    camera = camera_of(tables, sensor.mount, sensor.frames)
    paths = tuple(root / frame.filename for frame in sensor.frames)
    return CameraStream(
        name=sensor.name,
        camera=camera,
        rig_from_camera=pose_of(tables / "calibrated_sensor.json", sensor.mount),
        timestamps_us=np.array([frame.timestamp for frame in sensor.frames], np.int64),
        images=ImageFiles(paths, camera.width, camera.height, "sample_data.json"),
    )


def _lidar(root: Path, tables: Path, sensor: Sensor) -> LidarStream:
    mount = pose_of(tables / "calibrated_sensor.json", sensor.mount)
    times = np.array([frame.timestamp for frame in sensor.frames], np.int64)
    paths = tuple(root / frame.filename for frame in sensor.frames)
    return LidarStream(sensor.name, mount, times, NuScenesSweeps(times, paths, mount))


def read_key_tracks(
    tables: Path, samples: Sequence[SampleRow], world_from_rig: Trajectory, offset: Array
) -> dict[str, Track]:
    """Tracks by instance token, posed at key frames.

    Args:
        tables: folder of the JSON tables.
        samples: key frames of the scene.
        offset: (3,) global coordinates = world coordinates + offset.

    Raises:
        InputError: a table, column or value is wrong, a token leads nowhere, a category is unknown,
            a key frame has two boxes of one object, or a box is far from the ego.
    """
    times = {sample.token: sample.timestamp for sample in samples}
    path = tables / f"{_TABLE}.json"
    boxes = select(path, AnnotationRow, "sample_token", times)
    instances = linked(tables, "instance", InstanceRow, boxes, _TABLE, "instance_token")
    kinds = linked(
        tables, "category", CategoryRow, list(instances.values()), "instance", "category_token"
    )
    for kind in kinds.values():
        if kind.name not in (*CATEGORIES, EGO):
            raise InputError(
                tables / "category.json",
                f"token {kind.token}: name",
                f"{kind.name!r} is not a category of nuScenes",
                f"use one of {', '.join(CATEGORIES)}",
            )
    grouped: dict[str, dict[int, AnnotationRow]] = {}
    for box in boxes:
        of_instance = grouped.setdefault(box.instance_token, {})
        time = times[box.sample_token]
        if time in of_instance:
            field = f"token {box.token}: sample_token"
            problem = f"instance {box.instance_token} has a second box at this key frame"
            raise InputError(path, field, problem, _MEND)
        of_instance[time] = box
    return {
        token: _track(path, token, category, grouped[token], world_from_rig, offset)
        for token in grouped
        if (category := CATEGORIES.get(kinds[instances[token].category_token].name)) is not None
    }


def _track(
    path: Path,
    token: str,
    category: str,
    boxes: dict[int, AnnotationRow],
    world_from_rig: Trajectory,
    offset: Array,
) -> Track:
    times = np.array(sorted(boxes), np.int64)
    ordered = [boxes[int(time)] for time in times]
    poses = np.stack([pose_of(path, box) for box in ordered])
    poses[:, :3, 3] -= offset
    away = np.linalg.norm(poses[:, :3, 3] - world_from_rig.at(times)[:, :3, 3], axis=1)
    for box, distance in zip(ordered, away, strict=True):
        if not checks.are_box_sides(box.size).all():
            problem = f"is {box.size}, not a valid box size"
            raise InputError(path, f"token {box.token}: size", problem, "remove the box")
        if distance > _FARTHEST:
            problem = f"the box is {distance:.0f} m from the ego: mixed coordinate frames"
            raise InputError(path, f"token {box.token}: translation", problem, _MEND)
    width, length, height = np.median([box.size for box in ordered], axis=0)
    return Track(token, category, np.array([length, width, height]), Trajectory(times, poses))


def _filled(track: Track, key_frames: Sequence[int]) -> Track:
    """A track with poses ten times a second between key frames (in order).

    Poses between two key frames in a row that both show the object are interpolated, positions
    linearly and turns by slerp. Over a key frame without a box nothing is filled in.
    """
    times = track.trajectory.timestamps_us
    boxes = set(times.tolist())
    between = [
        start + (end - start) * step // STEPS
        for start, end in pairwise(key_frames)
        if start in boxes and end in boxes
        for step in range(1, STEPS)
    ]
    filled = np.sort(np.append(times, np.array(between, np.int64)))
    return replace(track, trajectory=Trajectory(filled, track.trajectory.at(filled)))
