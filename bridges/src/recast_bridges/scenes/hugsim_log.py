"""The log of a HUGSIM street, made of the street's own files, where its dataset is not at hand.

It has what the files tell: the camera's way, cameras, and the actors as tracks. It has no images,
no LiDAR and no map.
"""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import torch

from recast.arrays import Array
from recast.core.errors import InputError
from recast.core.files import require_new
from recast.geometry import se3
from recast.logs import CameraStream, DrivingLog, Track, Trajectory
from recast.logs.checks import refused
from recast.scene.imported import ImportRecord, import_with_log
from recast_bridges.scenes.actors import extent
from recast_bridges.scenes.hugsim import import_hugsim
from recast_bridges.scenes.hugsim_actors import (
    RECORDINGS_FILE,
    UPRIGHT,
    Clock,
    actor_names,
    own_axes,
    read_motion,
)
from recast_bridges.scenes.hugsim_files import (
    NAMES,
    Recording,
    front_camera,
    read_camera_poses,
    read_members,
    read_recordings,
)

RIG_FROM_CAMERA = np.array([[0.0, 0, 1], [-1, 0, 0], [0, -1, 0]])
"""Axes forward, left, up of a camera's right, down, forward."""
_MEND = "give the log that was imported from the dataset (`log`)"


def import_hugsim_with_log(
    path: str | Path,
    own_log: str | Path,
    out: str | Path,
    *,
    time_unit: float = 1.0,
    **options: Any,
) -> ImportRecord:
    """Write the log of a street's own files, and the street as a scene of it.

    Args:
        path: the scene's folder.
        own_log: folder to write the log to.
        time_unit: seconds of one unit of the scene's times.
        options: see `import_hugsim`.

    Raises:
        InputError: see `hugsim_log` and `import_hugsim`. Nothing is written then.
    """
    require_new(out)
    return import_with_log(
        hugsim_log(path, time_unit),
        own_log,
        lambda log: import_hugsim(path, log, out, time_unit=time_unit, **options),
    )


def hugsim_log(path: str | Path, time_unit: float = 1.0) -> DrivingLog:
    """The log of a street. Its rig is the ground below the front camera.

    Args:
        time_unit: seconds of one unit of the scene's times.

    Raises:
        InputError: a file is missing, broken or of another layout, or the front camera has fewer
            than two images.
    """
    folder = Path(path)
    poses, height = read_camera_poses(folder / "ground_param.pkl")
    recordings = read_recordings(folder / RECORDINGS_FILE)
    name, first = front_camera(recordings, poses[0])
    front = recordings[name]
    times = front.times[first:]
    if len(times) < 2:
        problem = "has fewer than two images from the scene's first one on"
        raise InputError(folder / RECORDINGS_FILE, f"camera {name}", problem, _MEND)
    clock = Clock(0, float(times[0]), time_unit)
    rig_from_camera = se3.from_rotation_translation(RIG_FROM_CAMERA, [0, 0, height])
    world_from_scene = rig_from_camera @ se3.inverse(front.poses[first])
    ego = Trajectory(
        clock.times_us(times).astype(np.int64),
        world_from_scene @ front.poses[first:] @ se3.inverse(rig_from_camera),
    )
    log = DrivingLog(
        name=folder.resolve().name,
        cameras={},
        lidars={},
        world_from_rig=ego,
        tracks={},
        metadata={"dataset": "HUGSIM", "licence": "that of the dataset", "images": "none"},
    )
    with refused(folder / RECORDINGS_FILE, _MEND):
        log.validate()
    cameras = {}
    for key, one in recordings.items():
        mount = rig_from_camera if key == name else _mount(one, ego, clock, world_from_scene)
        if mount is not None:
            cameras[key] = CameraStream(key, one.camera, mount, np.zeros(0, np.int64), [])
    log = replace(log, cameras=cameras, tracks=_tracks(folder, ego, clock, world_from_scene))
    with refused(folder, _MEND):
        log.validate()
    return log


def _mount(
    recording: Recording, ego: Trajectory, clock: Clock, world_from_scene: Array
) -> Array | None:
    """`rig_from_camera` of the first image that was taken on the ego's way."""
    times_us = clock.times_us(recording.times)
    there = np.flatnonzero((times_us >= ego.timestamps_us[0]) & (times_us <= ego.timestamps_us[-1]))
    if len(there) == 0:
        return None
    world_from_rig = ego.at(int(times_us[there[0]]))
    mount: Array = se3.inverse(world_from_rig) @ world_from_scene @ recording.poses[there[0]]
    return mount


def _tracks(
    folder: Path, ego: Trajectory, clock: Clock, world_from_scene: Array
) -> dict[str, Track]:
    """The actors that are there in the log's time, as cars of the size of their shape."""
    first, last = ego.timestamps_us[[0, -1]]
    tracks = {}
    for name in actor_names(folder):
        motion = read_motion(folder, name, clock, world_from_scene)
        if motion is None:
            continue
        there = (motion.timestamps_us >= first) & (motion.timestamps_us <= last)
        table, _ = read_members(folder / f"dynamic_{name}.pth")
        means = table.tensor(NAMES.means, None, 3)
        if not there.any() or len(means) == 0:
            continue
        found = own_axes(motion, None)
        axes = UPRIGHT if found is None else found
        turn = se3.from_rotation_translation(axes, np.zeros(3))
        own = Trajectory(motion.timestamps_us[there], motion.poses[there] @ se3.inverse(turn))
        size = extent(means @ torch.from_numpy(axes).float().T)
        tracks[name] = Track(name, "car", size, own)
    return tracks
