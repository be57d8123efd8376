"""DriveStudio's processed Waymo scenes: poses, boxes, LiDAR and images as a driving log.

Source: Chen et al., "OmniRe: Omni Urban Scene Reconstruction" (ICLR 2025), and the layout that its
framework's preprocessing writes.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Literal

import numpy as np
from numpy.typing import NDArray
from pydantic import ValidationError

from recast.core import files
from recast.core.errors import InputError
from recast.core.records import validation_error
from recast.geometry import se3
from recast.logs import checks
from recast.logs.importers.common import (
    ForeignRecord,
    Timed,
    are_returns,
    chosen_cameras,
    first_jump,
    read_points,
    returns_valid,
)
from recast.logs.importers.waymo_proto import LASER_NAME, LICENCE, lidar_name
from recast.logs.importers.waymo_segment import WAYMO_FROM_OPENCV
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
from recast_bridges.logs.processed_folder import (
    FARTHEST,
    NUMBER,
    CameraFolder,
    find_scene,
    frame_numbers,
    read_cameras,
    read_pose,
    rigid,
)

CATEGORIES = {"Vehicle": "car", "Pedestrian": "pedestrian", "Cyclist": "cyclist"}
_MEND = "process the scene again"

_Four = tuple[float, float, float, float]
LASERS = tuple(lidar_name(name) for name in LASER_NAME.names.values())
"""By number in the files, which is Waymo's LaserName less one."""
FLOATS = 14
"""Origin (3) and point (3) in the vehicle frame, flow (3), flow class, ground, intensity,
elongation, laser."""
_ORIGIN, _POINT = slice(0, 3), slice(3, 6)
_INTENSITY, _LASER = 11, 13
FRAME_US = 100_000
"""The folder has no times; Waymo's frames are ten a second."""


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
            problem = "belongs to DriveStudio's layout of a dataset other than Waymo"
            raise InputError(path, "layout", problem, "import the original dataset")


def _camera(camera: CameraFolder, frame_times: dict[int, int]) -> CameraStream:
    for frame, path in camera.images.items():
        if frame not in frame_times:
            raise InputError(path, "frame", f"{frame} has no file in ego_pose", _MEND)
    return camera.stream(camera.extrinsic @ WAYMO_FROM_OPENCV, frame_times)


class _Boxes(ForeignRecord):
    frame_idx: list[int]
    obj_to_world: list[tuple[_Four, _Four, _Four, _Four]]
    box_size: list[tuple[float, float, float]]


class _Instance(ForeignRecord):
    class_name: Literal["Vehicle", "Pedestrian", "Cyclist"]
    frame_annotations: _Boxes


def read_tracks(
    path: Path, frame_times: dict[int, int], world_from_rig: Trajectory, offset: Array
) -> dict[str, Track]:
    """Tracks by the file's own numbers; instances without boxes are left out.

    Args:
        frame_times: microseconds of each frame that has an ego pose.
        world_from_rig: ego trajectory.
        offset: (3,) global coordinates = world coordinates + offset.

    Raises:
        InputError: the file or a member is missing or wrong, a frame is unknown or comes twice, or
            a box is far from the ego.
    """
    value = files.read_json(path)
    if not isinstance(value, dict):
        raise InputError(path, "JSON", "is not an object", _MEND)
    tracks = {}
    for name, record in value.items():
        try:
            instance = _Instance.model_validate(record)
        except ValidationError as error:
            fault = validation_error(path, error, _MEND)
            raise InputError(path, f"{name}.{fault.field}", fault.problem, _MEND) from None
        if instance.frame_annotations.frame_idx:
            tracks[name] = _track(path, name, instance, frame_times, world_from_rig, offset)
    return tracks


def _track(
    path: Path,
    name: str,
    instance: _Instance,
    frame_times: dict[int, int],
    world_from_rig: Trajectory,
    offset: Array,
) -> Track:
    boxes, field = instance.frame_annotations, f"{name}.frame_annotations"
    if not len(boxes.frame_idx) == len(boxes.obj_to_world) == len(boxes.box_size):
        raise InputError(
            path, field, "frame_idx, obj_to_world and box_size differ in length", _MEND
        )
    unknown = next((frame for frame in boxes.frame_idx if frame not in frame_times), None)
    if unknown is not None:
        problem = f"{unknown} has no file in ego_pose"
        raise InputError(path, f"{field}.frame_idx", problem, "use the boxes of this scene")
    frames = np.array(boxes.frame_idx, np.int64)
    times = np.array([frame_times[frame] for frame in boxes.frame_idx], np.int64)
    twice = np.flatnonzero(np.diff(frames) <= 0)
    if len(twice):
        problem = f"{frames[twice[0] + 1]} does not come after {frames[twice[0]]}"
        raise InputError(path, f"{field}.frame_idx", problem, _MEND)
    poses = np.stack(
        [
            rigid(np.array(matrix), path, f"{field}.obj_to_world.{i}")
            for i, matrix in enumerate(boxes.obj_to_world)
        ]
    )
    poses[:, :3, 3] -= offset
    away = np.linalg.norm(poses[:, :3, 3] - world_from_rig.at(times)[:, :3, 3], axis=1)
    if np.any(away > FARTHEST):
        i = int(np.argmax(away > FARTHEST))
        problem = f"the box is {away[i]:.0f} m from the ego: mixed coordinate frames"
        raise InputError(path, f"{field}.obj_to_world.{i}", problem, _MEND)
    size = np.array(boxes.box_size)
    wrong = ~checks.are_box_sides(size).all(axis=1)
    if wrong.any():
        i = int(np.argmax(wrong))
        raise InputError(path, f"{field}.box_size.{i}", "is not a valid box size", "remove the box")
    category = CATEGORIES[instance.class_name]
    return Track(name, category, np.median(size, axis=0), Trajectory(times, poses))


def read_lidars(folder: Path, frame_times: dict[int, int]) -> dict[str, LidarStream]:
    """A stream for each scanner that the first file has points of; none without the folder.

    Their mountings are the origins of their rays there; how they are turned is not written, so
    they have the vehicle's axes.

    Args:
        frame_times: microseconds of each frame that has an ego pose.

    Raises:
        InputError: a file belongs to no frame, or the first is broken.
    """
    listed = {}
    for path in sorted(folder.glob("*.bin")):
        if not NUMBER.fullmatch(path.stem) or int(path.stem) not in frame_times:
            raise InputError(path, "file name", "is not a frame with an ego pose", _MEND)
        listed[int(path.stem)] = path
    if not listed:
        return {}
    times = np.array([frame_times[frame] for frame in sorted(listed)], np.int64)
    paths = tuple(listed[frame] for frame in sorted(listed))
    rows = read_rows(paths[0])
    lidars = {}
    for number, name in enumerate(LASERS):
        mine = rows[rows[:, _LASER] == number]
        if len(mine):
            origin = np.median(mine[:, _ORIGIN].astype(np.float64), axis=0)
            mount = se3.from_rotation_translation(np.eye(3), origin)
            sweeps = DriveStudioSweeps(times, paths, number)
            lidars[name] = LidarStream(name, mount, times, sweeps)
    return lidars


def read_rows(path: Path) -> NDArray[np.float32]:
    """Rows (N, 14) of a file that have a return. Raises InputError: cut off, of another layout, not
    finite, or of an unknown scanner."""
    rows = read_points(path, FLOATS, _POINT, [0, 1, 2, _INTENSITY, _LASER], _MEND)
    rows = rows[are_returns(rows[:, _POINT], rows[:, _ORIGIN])]
    known = np.isin(rows[:, _LASER], range(len(LASERS)))
    if not known.all():
        point = int(np.argmin(known))
        problem = f"is {rows[point, _LASER]:g}, not 0 to {len(LASERS) - 1}"
        raise InputError(path, f"point {point}: laser", problem, _MEND)
    return rows


@dataclass(frozen=True)
class DriveStudioSweeps(Timed):
    """Sweeps of one scanner, read on demand; a `SweepSource`. The ego motion is undone in them."""

    timestamps_us: Int64Array  # (S,) int64
    paths: tuple[Path, ...]  # S files
    laser: int  # the scanner's number

    def __getitem__(self, index: int) -> LidarSweep:
        """Read sweep `index`; raises as `read_rows` does."""
        rows = read_rows(self.paths[index])
        mine = rows[rows[:, _LASER] == self.laser]
        # Waymo's intensities have no upper bound.
        intensity = np.tanh(np.maximum(mine[:, _INTENSITY], 0.0))
        return LidarSweep(int(self.timestamps_us[index]), mine[:, _POINT], intensity)
