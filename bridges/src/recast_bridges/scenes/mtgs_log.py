"""The log of a published MTGS street, made of the street's own files, where nuPlan is not at hand.

It has what the files tell: the ego's way, cameras, and the actors as tracks. It has no images, no
LiDAR and no map.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np

from recast.arrays import Array
from recast.cameras import PinholeCamera
from recast.core.errors import InputError
from recast.core.files import require_new
from recast.geometry import se3
from recast.logs import CameraStream, DrivingLog, Track, Trajectory
from recast.logs.checks import refused
from recast.scene.imported import ImportRecord, import_with_log
from recast_bridges.scenes.actors import extent
from recast_bridges.scenes.checkpoint import CheckpointTable, read_checkpoint
from recast_bridges.scenes.mtgs import find_checkpoint, import_mtgs, read_nodes
from recast_bridges.scenes.mtgs_frames import FRAMES_FILE, read_drives, read_places
from recast_bridges.scenes.mtgs_nodes import NAMES, SCENERY, read_motion
from recast_bridges.scenes.mtgs_odyssey import read_shift

_SIDES = ("height", "width")
SIZE = (1080, 1920)
"""Height and width of nuPlan's images in pixels, which the files may leave out."""
CATEGORIES = {"vehicle": "car", "bicycle": "cyclist", "pedestrian": "pedestrian"}
_MEND = "give the log that was imported from nuPlan (`log`)"


def import_mtgs_with_log(
    path: str | Path, own_log: str | Path, out: str | Path, **options: Any
) -> ImportRecord:
    """Write the log of a street's own files, and the street as a scene of it.

    Args:
        path: the scene's folder.
        own_log: folder to write the log to.
        options: see `import_mtgs`.

    Raises:
        InputError: see `mtgs_log` and `import_mtgs`. Nothing is written then.
    """
    require_new(out)
    return import_with_log(
        mtgs_log(path), own_log, lambda log: import_mtgs(path, log, out, **options)
    )


def mtgs_log(path: str | Path) -> DrivingLog:
    """The log of a street: of the drive with most frames, if it was recorded on several.

    The rig is nuPlan's ego frame, whose origin is the rear axle, about 0.3 m above the ground.

    Raises:
        InputError: a file is missing, broken or of another layout, or there are fewer than two
            frames.
    """
    folder, file = find_checkpoint(Path(path))
    if folder is None:
        raise InputError(path, "scene folder", "is a file", "name the folder, or give `log`")
    root = read_checkpoint(file, arrays=True)
    drives = read_drives(folder / FRAMES_FILE)
    name, frames = max(drives.items(), key=lambda item: len(item[1]), default=("", []))
    if len(frames) < 2:
        raise InputError(folder / FRAMES_FILE, "drives", "have fewer than two frames", _MEND)
    times, _ = read_places(frames)
    poses = np.stack([_ego_pose(frame) for frame in frames])
    origin = poses[0, :3, 3].copy()
    poses[:, :3, 3] -= origin
    shift = read_shift(root.table("background").table("config"))
    metadata = {"dataset": "nuPlan, as MTGS keeps it", "drive": name, "licence": "that of nuPlan"}
    log = DrivingLog(
        name=f"{file.stem}-{name}" if name else file.stem,
        cameras={key: _camera(key, own) for key, own in _cameras(frames[0]).items()},
        lidars={},
        world_from_rig=Trajectory(times, poses),
        tracks={},
        world_offset=shift + origin,
        metadata={**metadata, "images": "none"},
    )
    with refused(folder / FRAMES_FILE, _MEND):
        log.validate()
    world_from_scene = se3.from_rotation_translation(np.eye(3), -origin)
    log = replace(log, tracks=_tracks(root, log, world_from_scene, _categories(frames)))
    with refused(file, _MEND):
        log.validate()
    return log


def _ego_pose(frame: CheckpointTable) -> Array:
    """(4, 4) of the ego in the scene; `read_places` has checked the place."""
    if "ego2global" in frame:
        pose = frame.array("ego2global")
        if pose.shape == (4, 4) and np.all(np.isfinite(pose)):
            return se3.from_rotation_translation(pose[:3, :3], pose[:3, 3])
    return _placed(frame, "ego2global_rotation", "ego2global_translation")


def _placed(table: CheckpointTable, rotation: str, translation: str) -> Array:
    """(4, 4) of a quaternion wxyz or a matrix, and three metres."""
    turn, place = table.array(rotation), table.array(translation).reshape(-1)
    if turn.shape == (4,) and 1e-6 < np.linalg.norm(turn) < 1e6:
        turn = se3.quat_to_matrix(turn)
    if turn.shape != (3, 3) or not np.all(np.isfinite(turn)):
        raise table.fault(rotation, "is neither a quaternion nor a rotation matrix", _MEND)
    if place.shape != (3,) or not np.all(np.isfinite(place)):
        raise table.fault(translation, "is not three metres", _MEND)
    return se3.from_rotation_translation(turn, place)


def _cameras(frame: CheckpointTable) -> dict[str, CheckpointTable]:
    cameras = frame.table("cams")
    return {name: cameras.table(name) for name in cameras}


def _camera(name: str, own: CheckpointTable) -> CameraStream:
    """A camera without images; the intrinsics that were refined for the training are preferred."""
    lens = own.table("colmap_param") if "colmap_param" in own else own
    matrix, bend = lens.array("cam_intrinsic"), lens.array("distortion").reshape(-1)
    if matrix.shape != (3, 3) or bend.shape != (5,):
        raise lens.fault("cam_intrinsic", "or distortion: is not 3x3, or not five numbers", _MEND)
    height, width = (own.number(key, side) for key, side in zip(_SIDES, SIZE, strict=True))
    if not (1 <= width <= 1e5 and 1 <= height <= 1e5):
        raise own.fault("width", f"or height: {width:g} x {height:g} pixels", _MEND)
    fx, fy, cx, cy = (float(matrix[place]) for place in ((0, 0), (1, 1), (0, 2), (1, 2)))
    k1, k2, p1, p2, k3 = (float(one) for one in bend)
    size = round(width), round(height)
    camera = PinholeCamera(*size, fx, fy, cx, cy, (k1, k2, p1, p2, k3))
    mount = _placed(own, "sensor2ego_rotation", "sensor2ego_translation")
    return CameraStream(name, camera, mount, np.zeros(0, np.int64), [])


def _categories(frames: Sequence[CheckpointTable]) -> dict[str, str]:
    """The category of each token that the frames name."""
    found: dict[str, str] = {}
    for frame in frames:
        for token, name in zip(frame.texts("track_tokens"), frame.texts("gt_names"), strict=False):
            found.setdefault(token, CATEGORIES.get(name, "misc"))
    return found


def _tracks(
    root: CheckpointTable, log: DrivingLog, world_from_scene: Array, categories: Mapping[str, str]
) -> dict[str, Track]:
    """The actors that are there in the log's time; a vehicle where no category is known."""
    first, last = log.world_from_rig.timestamps_us[[0, -1]]
    tracks = {}
    for token, node in read_nodes(root, ())[0].items():
        if node.kind in SCENERY:
            continue
        motion = read_motion(node, log, world_from_scene)
        means = node.gaussians.tensor(NAMES.means, None, 3)
        if motion is None or len(means) == 0:
            continue
        times = motion.trajectory.timestamps_us
        there = (times >= first) & (times <= last)
        if there.any():
            own = Trajectory(times[there], motion.trajectory.poses[there])
            tracks[token] = Track(token, categories.get(token, "car"), extent(means), own)
    return tracks
