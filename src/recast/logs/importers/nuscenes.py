"""nuScenes scenes: poses, boxes, LiDAR and cameras of the JSON tables as a driving log.

Source: Caesar et al., "nuScenes: A multimodal dataset for autonomous driving" (CVPR 2020), and the
dataset's published schema.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace
from itertools import pairwise
from pathlib import Path

import numpy as np

from recast.core.errors import InputError
from recast.logs import checks
from recast.logs.images import ImageFiles
from recast.logs.importers.common import chosen_cameras, returns_valid, unknown_drive
from recast.logs.importers.nuscenes_sensors import (
    NuScenesSweeps,
    Sensor,
    camera_of,
    pose_of,
    read_ego,
    read_sensors,
)
from recast.logs.importers.nuscenes_tables import (
    AnnotationRow,
    CategoryRow,
    InstanceRow,
    LogRow,
    SampleRow,
    SceneRow,
    linked,
    select,
)
from recast.logs.plausibility import turned_around
from recast.logs.types import Array, CameraStream, DrivingLog, LidarStream, Track, Trajectory

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
    "vehicle.motorcycle": "cyclist",
    "vehicle.trailer": "truck",
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
