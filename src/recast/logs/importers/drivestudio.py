"""DriveStudio's processed Waymo scenes: poses, boxes, LiDAR and images as a driving log.

Source: Chen et al., "OmniRe: Omni Urban Scene Reconstruction" (ICLR 2025), and the layout that its
framework's preprocessing writes.
"""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path

import numpy as np

from recast.errors import InputError
from recast.logs.importers.cameras import chosen_cameras
from recast.logs.importers.drivestudio_instances import read_tracks
from recast.logs.importers.drivestudio_lidar import read_lidars
from recast.logs.importers.image_files import ImageFiles
from recast.logs.importers.pose_jumps import first_jump
from recast.logs.importers.processed_folder import (
    CameraFolder,
    find_scene,
    frame_numbers,
    read_cameras,
    read_pose,
)
from recast.logs.importers.valid import returns_valid
from recast.logs.importers.waymo_schema import LICENCE
from recast.logs.importers.waymo_values import WAYMO_FROM_OPENCV
from recast.logs.types import CameraStream, DrivingLog, Trajectory

FRAME_US = 100_000
"""The folder has no times; Waymo's frames are ten a second."""
_MEND = "process the scene again"


@returns_valid
def load_drivestudio(
    root: Path, drive: str, labels: Path | None = None, cameras: Sequence[str] = ()
) -> DrivingLog:
    """Read a processed Waymo scene, without a map; images and sweeps are decoded when asked for.

    Args:
        root: folder that holds the scenes, or the scene itself.
        drive: the scene's folder, such as 023.
        labels: another file in the format of instances/instances_info.json.
        cameras: Waymo's names of the cameras to read, such as FRONT; all if empty.

    Raises:
        InputError: files are missing, broken or do not belong together, or the scene is not
            Waymo's.
    """
    scene = find_scene(Path(root), drive, "DriveStudio")
    _check_is_waymo(scene)
    frames = frame_numbers(scene / "ego_pose")
    poses = np.stack([read_pose(path) for path in frames.values()])
    frame_times = {frame: frame * FRAME_US for frame in frames}
    times = np.array(list(frame_times.values()), np.int64)
    jump = first_jump(times, poses)
    if jump is not None:
        problem = f"is {jump[1]:.0f} m from the frame before: mixed coordinate frames"
        raise InputError(list(frames.values())[jump[0]], "matrix", problem, _MEND)
    offset = poses[0, :3, 3].copy()
    poses[:, :3, 3] -= offset
    trajectory = Trajectory(times, poses)
    mounted = {camera.name: camera for camera in read_cameras(scene)}
    chosen = chosen_cameras(scene, mounted, cameras)
    instances = scene / "instances" / "instances_info.json" if labels is None else Path(labels)
    return DrivingLog(
        name=f"drivestudio {drive}",
        cameras={name: _camera(mounted[name], frame_times) for name in chosen},
        lidars=read_lidars(scene / "lidar", frame_times),
        world_from_rig=trajectory,
        tracks=read_tracks(instances, frame_times, trajectory, offset),
        world_offset=offset,
        metadata={
            "dataset": "Waymo, processed by DriveStudio",
            "drive": drive,
            "licence": LICENCE,
        },
    )


def _check_is_waymo(scene: Path) -> None:
    for path in (scene / "lidar_pose", *sorted((scene / "extrinsics").glob("*_*.txt"))):
        if path.exists():
            problem = "belongs to DriveStudio's layout of another dataset than Waymo"
            raise InputError(path, "layout", problem, "import that dataset itself")


def _camera(camera: CameraFolder, frame_times: dict[int, int]) -> CameraStream:
    for frame, path in camera.images.items():
        if frame not in frame_times:
            raise InputError(path, "frame", f"{frame} has no file in ego_pose", _MEND)
    width, height = camera.camera.width, camera.camera.height
    return CameraStream(
        name=camera.name,
        camera=camera.camera,
        rig_from_camera=camera.extrinsic @ WAYMO_FROM_OPENCV,
        timestamps_us=np.array([frame_times[frame] for frame in camera.images], np.int64),
        images=ImageFiles(tuple(camera.images.values()), width, height, "its first image"),
    )
