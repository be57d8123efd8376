"""Street Gaussians' processed Waymo scenes: poses, boxes, points and images as a driving log.

Source: Yan et al., "Street Gaussians: Modeling Dynamic Urban Scenes with Gaussian Splatting" (ECCV
2024), and the layout that its preprocessing writes.
"""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path

import numpy as np

from recast.errors import InputError
from recast.logs.importers.cameras import chosen_cameras
from recast.logs.importers.image_files import ImageFiles
from recast.logs.importers.processed_folder import CameraFolder, find_scene, read_cameras
from recast.logs.importers.street_gaussians_ego import Drive, read_drive
from recast.logs.importers.street_gaussians_points import read_lidar
from recast.logs.importers.street_gaussians_tracks import read_tracks
from recast.logs.importers.valid import returns_valid
from recast.logs.importers.waymo_schema import LICENCE
from recast.logs.types import CameraStream, DrivingLog


@returns_valid
def load_street_gaussians(
    root: Path, drive: str, labels: Path | None = None, cameras: Sequence[str] = ()
) -> DrivingLog:
    """Read a processed Waymo scene, without a map; images and sweeps are decoded when asked for.

    Args:
        root: folder that holds the scenes, or the scene itself.
        drive: the scene's folder, such as 002.
        labels: another file in the format of track/track_info.txt, such as a tracker's.
        cameras: Waymo's names of the cameras to read, such as FRONT; all if empty.

    Raises:
        InputError: files are missing, broken, hold pickled objects or do not belong together.
    """
    scene = find_scene(Path(root), drive, "Street Gaussians")
    mounted = {camera.name: camera for camera in read_cameras(scene)}
    chosen = chosen_cameras(scene, mounted, cameras)
    timed = read_drive(scene, list(mounted.values()))
    tracks = scene / "track" / "track_info.txt" if labels is None else Path(labels)
    return DrivingLog(
        name=f"street-gaussians {drive}",
        cameras={name: _camera(scene, mounted[name], timed) for name in chosen},
        lidars=read_lidar(scene / "pointcloud.npz", timed),
        world_from_rig=timed.world_from_rig,
        tracks=read_tracks(tracks, timed),
        world_offset=timed.offset,
        metadata={
            "dataset": "Waymo, processed by Street Gaussians",
            "drive": drive,
            "licence": LICENCE,
        },
    )


def _camera(scene: Path, camera: CameraFolder, drive: Drive) -> CameraStream:
    times = drive.image_times[camera.number]
    ordered = sorted(times, key=lambda frame: times[frame])
    stamps = np.array([times[frame] for frame in ordered], np.int64)
    if np.any(np.diff(stamps) == 0):
        frame = ordered[int(np.argmin(np.diff(stamps))) + 1]
        problem = "is the time of another image"
        field = f"{camera.name}.{frame:06d}"
        raise InputError(scene / "timestamps.json", field, problem, "process the scene again")
    paths = tuple(camera.images[frame] for frame in ordered)
    width, height = camera.camera.width, camera.camera.height
    return CameraStream(
        name=camera.name,
        camera=camera.camera,
        rig_from_camera=camera.extrinsic,
        timestamps_us=stamps,
        images=ImageFiles(paths, width, height, "its first image"),
    )
