"""Logs in the unified format of the `py123d` package, whatever dataset they came from.

Source: the scene interface of py123d 0.7 (https://github.com/kesai-labs/py123d), which is an
optional package and imported here only.
"""

from __future__ import annotations

import importlib
from collections.abc import Sequence
from pathlib import Path
from typing import Any

import numpy as np

from recast.errors import InputError
from recast.geometry import se3
from recast.logs import motion
from recast.logs.checks import refused
from recast.logs.importers.cameras import chosen_cameras
from recast.logs.importers.py123d_map import read_map
from recast.logs.importers.py123d_sensors import matrix, read_cameras, read_lidars, reading
from recast.logs.importers.py123d_tracks import read_tracks
from recast.logs.importers.valid import returns_valid
from recast.logs.types import Array, DrivingLog, Trajectory
from recast.tables import check_batches

SYNC = "sync.arrow"
_LISTED = 5
_LARGEST_BATCH = 1 << 30
"""Bytes in memory."""


@returns_valid
def load_py123d(
    root: Path, drive: str, labels: Path | None = None, cameras: Sequence[str] = ()
) -> DrivingLog:
    """Read a log, with its map if it has one; images and sweeps are decoded when asked for.

    Args:
        root: py123d's data folder, which holds `logs` and `maps`.
        drive: the log's name.
        labels: must be None, since a log holds its own.
        cameras: py123d's names of the cameras to read; all if empty.

    Raises:
        InputError: py123d is not installed or cannot read the log, or the log lacks what is
            needed.
    """
    if labels is not None:
        raise InputError(labels, "labels", "a log holds its own", "leave the option out")
    folder = find_log(Path(root), drive)
    scene_type = _scene_type()
    for path in sorted(folder.glob("*.arrow")):  # py123d maps them into memory as they are
        check_batches(path, "convert the log again", _LARGEST_BATCH)
    with reading(folder):
        scene = scene_type(folder, maps_root=Path(root) / "maps")
        return log_of(scene, folder, cameras)


def log_of(scene: Any, folder: Path, cameras: Sequence[str] = ()) -> DrivingLog:
    """The log of a py123d scene.

    Args:
        scene: a `py123d.api.SceneAPI`.
        folder: for messages.
        cameras: names of the cameras to keep; all if empty.

    Raises:
        InputError: there are fewer than two ego poses, or a sensor or box is not as it must be.
    """
    ego = scene.get_ego_state_se3_metadata()
    times = [time.time_us for time in scene.get_all_ego_state_se3_timestamps()]
    if ego is None or len(times) < 2:
        raise InputError(folder, "ego states", "there are fewer than two", "convert the log again")
    rig_from_imu = _rig_from_imu(ego)
    poses = np.stack(
        [matrix(scene.get_ego_state_se3_at_timestamp(time).imu_se3) for time in times]
    ) @ se3.inverse(rig_from_imu)
    offset: Array = poses[0, :3, 3].copy()
    poses[:, :3, 3] -= offset
    trajectory = Trajectory(np.array(times, np.int64), poses)
    with refused(folder, "convert the log again"):
        trajectory.validate("ego states")
    trajectory = motion.extended(
        trajectory, times[0] - motion.MAX_EXTENSION_US, times[-1] + motion.MAX_EXTENSION_US
    )
    streams, left_out = read_cameras(scene, folder, rig_from_imu, trajectory)
    chosen = chosen_cameras(folder, streams, cameras)
    known = scene.get_log_metadata()
    metadata = {
        "dataset": f"{known.dataset}, through py123d",
        "drive": known.log_name,
        "split": known.split,
        "licence": f"that of {known.dataset}",
        **({} if known.location is None else {"location": known.location}),
        **({"cameras_left_out": ", ".join(left_out)} if left_out else {}),
    }
    return DrivingLog(
        name=known.log_name,
        cameras={name: streams[name] for name in chosen},
        lidars=read_lidars(scene, folder, rig_from_imu, trajectory),
        world_from_rig=trajectory,
        tracks=read_tracks(scene, folder, trajectory, offset),
        map=read_map(scene.get_map_api(), folder, trajectory.poses[:, :3, 3], offset),
        world_offset=offset,
        metadata=metadata,
    )


def _rig_from_imu(ego: Any) -> Array:
    """The rig stands below the rear axle on the ground, which is the underside of the ego's box."""
    imu_from_axle, imu_from_box = matrix(ego.rear_axle_to_imu_se3), matrix(ego.center_to_imu_se3)
    axle_from_box = se3.inverse(imu_from_axle) @ imu_from_box
    rig_from_axle = np.eye(4)
    rig_from_axle[2, 3] = ego.height / 2 - axle_from_box[2, 3]
    return rig_from_axle @ se3.inverse(imu_from_axle)


def find_log(root: Path, drive: str) -> Path:
    """The folder of log `drive` below `root`/logs.

    Raises:
        InputError: the folder or the log does not exist, or several have the name.
    """
    logs = root / "logs"
    if not logs.is_dir():
        raise InputError(root, "py123d data", "holds no folder logs", "name the folder that does")
    known = sorted(path.parent for path in logs.rglob(SYNC))
    found = [folder for folder in known if folder.name == drive]
    if len(found) > 1:
        listed = ", ".join(str(folder.relative_to(logs)) for folder in found[:_LISTED])
        raise InputError(root, f"drive {drive}", f"may be {listed}", "take one away")
    if not found:
        shown = ", ".join(folder.name for folder in known[:_LISTED]) or "none here"
        raise InputError(root, f"drive {drive}", "does not exist", f"choose one of {shown}")
    return found[0]


def _scene_type() -> Any:
    """`ArrowSceneAPI`: the scene of a whole log."""
    try:
        return importlib.import_module("py123d.api.scene.arrow.arrow_scene_api").ArrowSceneAPI
    except ImportError as error:
        problem = f"cannot be imported ({error})"
        raise InputError("py123d", "package", problem, "pip install 'py123d>=0.7'") from None
