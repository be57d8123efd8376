"""nuScenes scenes: poses, boxes, LiDAR and cameras of the JSON tables as a driving log.

Source: Caesar et al., "nuScenes: A multimodal dataset for autonomous driving" (CVPR 2020), and the
dataset's published schema.
"""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path

import numpy as np

from recast.errors import InputError
from recast.logs.importers.cameras import chosen_cameras
from recast.logs.importers.image_files import ImageFiles
from recast.logs.importers.nuscenes_ego import read_ego
from recast.logs.importers.nuscenes_frames import Sensor, read_sensors
from recast.logs.importers.nuscenes_labels import read_tracks
from recast.logs.importers.nuscenes_sensors import NuScenesSweeps, camera_of, pose_of
from recast.logs.importers.nuscenes_tables import LogRow, SampleRow, SceneRow, linked, select
from recast.logs.importers.valid import returns_valid
from recast.logs.types import CameraStream, DrivingLog, LidarStream

LICENCE = "CC BY-NC-SA 4.0"
_LISTED = 5
"""Names of other scenes in a message; a split has hundreds."""


@returns_valid
def load_nuscenes(
    root: Path, drive: str, labels: Path | None = None, cameras: Sequence[str] = ()
) -> DrivingLog:
    """Read a nuScenes scene, without a map; images and sweeps are decoded when asked for.

    Args:
        root: the dataset's folder, which holds v1.0-mini, v1.0-trainval or v1.0-test, samples and
            sweeps. Without the folder sweeps, only key frames are read.
        drive: the scene's name, such as scene-0061.
        labels: must be None, since the tables hold the boxes.
        cameras: names of the cameras to read, such as CAM_FRONT; all if empty. The files of
            others need not be there.

    Raises:
        InputError: tables or files are missing, broken or do not belong together.
    """
    if labels is not None:
        raise InputError(labels, "labels", "nuScenes tables hold the boxes", "leave the option out")
    root = Path(root)
    tables, scene = _find_scene(root, drive)
    recording = linked(tables, "log", LogRow, [scene], "scene", "log_token")[scene.log_token]
    samples = select(tables / "sample.json", SampleRow, "scene_token", {scene.token})
    sensors = read_sensors(root, tables, samples, cameras)
    mounted = [sensor.name for sensor in sensors if sensor.kind == "camera"]
    chosen = chosen_cameras(root / drive, mounted, cameras)
    trajectory, offset = read_ego(tables, samples, sensors)
    return DrivingLog(
        name=scene.name,
        cameras={s.name: _camera(root, tables, s) for s in sensors if s.name in chosen},
        lidars={s.name: _lidar(root, tables, s) for s in sensors if s.kind == "lidar"},
        world_from_rig=trajectory,
        tracks=read_tracks(tables, samples, trajectory, offset),
        world_offset=offset,
        metadata={
            "dataset": f"nuScenes {tables.name}",
            "drive": scene.name,
            "location": recording.location,
            "date": recording.date_captured,
            "vehicle": recording.vehicle,
            "licence": LICENCE,
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
    shown = ", ".join(sorted(names)[:_LISTED])
    more = f" and {len(names) - _LISTED} more" if len(names) > _LISTED else ""
    raise InputError(root, f"drive {drive}", "does not exist", f"choose one of {shown}{more}")


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
