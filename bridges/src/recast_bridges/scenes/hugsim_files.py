"""Files of a HUGSIM scene: Gaussians as tuples, motion models, and the recorded camera's places.

Tuples are saved with `torch.save`, the camera's places with pickle; neither is ever run.
"""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path, PurePosixPath
from typing import Any

import numpy as np
import torch
from scipy.spatial.transform import Rotation

from recast.arrays import Array
from recast.cameras import PinholeCamera
from recast.core.errors import InputError
from recast.core.files import read_json
from recast.core.torch_file import read_torch_file
from recast.geometry import se3
from recast.logs.checks import WORLD_REACH, refused
from recast.splats import Gaussians
from recast.splats.gaussians import MAX_DEGREE
from recast_bridges.scenes.checkpoint import (
    ARRAYS,
    CheckpointTable,
    Names,
    read_gaussians,
    read_harmonics,
    read_pickle,
)

FIELDS = (
    *("active_sh_degree", "xyz", "features_dc", "features_rest"),
    *("feats3D", "scaling", "rotation", "opacity"),
)
"""The first members of every tuple of Gaussians."""
NAMES = Names("xyz", "features_rest", "scaling", "rotation", "opacity")
CONSTANT = "features_dc"
MOTION = ("a", "b", "v", "pitchroll", "yaw", "h", "train_timestamp", "delta")
THICKNESS_M = 0.001
"""Standard deviation of the ground's Gaussians along the vertical axis."""
_MEND = "give a scene as HUGSIM exports it; see docs/howto/published_streets.md"


def read_members(path: Path) -> tuple[CheckpointTable, int | None]:
    """The members of a tuple of Gaussians by name, a ground's among them; its training step. Raises
    InputError: the file is missing, broken or of another layout."""
    content = read_torch_file(path, "copy it again", safe=ARRAYS)
    if not isinstance(content, tuple | list) or len(content) != 2:
        raise InputError(path, "file", "is not a pair of Gaussians and iteration", _MEND)
    own, iteration = content
    step = iteration if type(iteration) is int and 0 <= iteration <= 1 << 53 else None
    members = _named(path, "Gaussians", own)
    if len(own) in (11, 15):  # a whole scene, as of now and as it was saved at first
        members |= {"appearance": own[-2], "ground": own[-1]}
    return CheckpointTable(path, members), step


def _named(path: Path, field: str, members: Any) -> dict[str, Any]:
    if not isinstance(members, tuple | list) or len(members) < len(FIELDS):
        raise InputError(path, field, f"is not a tuple of {len(FIELDS)} members or more", _MEND)
    return dict(zip(FIELDS, members, strict=False))


def read_ground(table: CheckpointTable) -> CheckpointTable | None:
    """The ground's members by name, or None if the scene has no ground of its own. Raises
    InputError: it is no tuple of Gaussians."""
    if table.raw("ground") is None:
        return None
    return CheckpointTable(table.path, _named(table.path, "ground", table.raw("ground")), "ground")


def read_hugsim_gaussians(table: CheckpointTable, flat: bool = False) -> Gaussians:
    """The Gaussians of a tuple, in its own axes.

    Args:
        flat: whether their sizes are along x and z only, as the ground's.

    Raises:
        InputError: a member is missing, of another shape, not finite, or out of range.
    """
    degree = table.number("active_sh_degree")
    if degree not in range(MAX_DEGREE + 1):
        raise table.fault("active_sh_degree", f"is {degree:g}, expected 0 to {MAX_DEGREE}")
    count = len(table.tensor(NAMES.means, None, 3))
    changes = {NAMES.rest: read_harmonics(table, NAMES.rest, count, degree)}
    if flat:
        sides = table.tensor(NAMES.log_scales, count, 2)
        thin = torch.full((count,), math.log(THICKNESS_M))
        changes[NAMES.log_scales] = torch.stack([sides[:, 0], thin, sides[:, 1]], dim=1)
    constant = table.tensor(CONSTANT, count, 1, 3)[:, 0]
    return read_gaussians(table.changed(changes), NAMES, constant)


def read_camera_poses(path: Path) -> tuple[Array, float]:
    """Poses (F, 4, 4) of the recorded front camera in the scene, and its height in metres. Raises
    InputError: the file is missing, damaged, holds other things than plain values and arrays, or
    poses that are not rigid; no code in it is run."""
    content = read_pickle(path, _MEND)
    if not isinstance(content, tuple | list) or len(content) != 3:
        raise InputError(path, "pickle", "is not a triple of poses, height and commands", _MEND)
    table = CheckpointTable(path, {"cam_poses": content[0], "cam_height": content[1]})
    poses = rigid_poses(table, "cam_poses", table.array("cam_poses"))
    height = table.number("cam_height")
    if not 0 <= height <= 10:
        raise table.fault("cam_height", f"is {height:g}, expected metres from 0 to 10")
    return poses, height


def rigid_poses(table: CheckpointTable, name: str, poses: Array) -> Array:
    """Poses (F, 4, 4) of a member, checked. Raises InputError: another shape, not rigid, or too
    far."""
    if poses.ndim != 3 or poses.shape[1:] != (4, 4) or len(poses) == 0:
        raise table.fault(name, f"has shape {list(poses.shape)}, expected [any, 4, 4]", _MEND)
    turns = poses[:, :3, :3]
    fine = np.all(np.abs(poses) <= WORLD_REACH)  # not NaN
    if not fine or not np.allclose(turns @ turns.swapaxes(1, 2), np.eye(3), 0, 1e-3):
        raise table.fault(name, "holds a matrix that is not a pose in metres", _MEND)
    if not np.all(np.linalg.det(turns) > 0):
        raise table.fault(name, "holds a mirrored pose", _MEND)
    return se3.from_rotation_translation(se3.nearest_rotations(turns)[0], poses[:, :3, 3])


@dataclass(frozen=True)
class Recording:
    """The images that a scene was trained on, of one camera, in the order of their times."""

    times: Array  # (F,) times of the images in the scene's unit
    poses: Array  # (F, 4, 4) poses of the camera in the scene
    camera: PinholeCamera  # intrinsics


def read_recordings(path: Path) -> dict[str, Recording]:
    """The cameras of meta_data.json by name, which is that of the folder of their images. Raises
    InputError: the file is missing, or a frame is not as it must be."""
    value = read_json(path)
    frames = value.get("frames") if isinstance(value, dict) else None
    if not isinstance(frames, list) or not frames:
        raise InputError(path, "frames", "is not a list, or empty", _MEND)
    rows: dict[str, list[tuple[float, Array, CheckpointTable]]] = {}
    for index, row in enumerate(frames):
        if not isinstance(row, dict):
            raise InputError(path, f"frames[{index}]", "is not a table", _MEND)
        frame = CheckpointTable(path, row, f"frames[{index}]")
        pose = rigid_poses(frame, "camtoworld", frame.array("camtoworld")[None])[0]
        name = PurePosixPath(frame.text("rgb_path")).parent.name or "camera"
        rows.setdefault(name, []).append((frame.number("timestamp"), pose, frame))
    found = {}
    for name, own in rows.items():
        own.sort(key=lambda one: one[0])
        times = np.array([time for time, _, _ in own])
        if np.any(np.diff(times) <= 0):
            raise InputError(path, f"camera {name}", "has two images at one time", _MEND)
        poses = np.stack([pose for _, pose, _ in own])
        found[name] = Recording(times, poses, _intrinsics(own[0][2]))
    return found


def _intrinsics(frame: CheckpointTable) -> PinholeCamera:
    matrix, width, height = frame.array("intrinsics"), frame.number("width"), frame.number("height")
    if matrix.shape not in ((3, 3), (4, 4)) or not (1 <= width <= 1e5 and 1 <= height <= 1e5):
        raise frame.fault("intrinsics", "or width or height: are not valid for a camera", _MEND)
    fx, fy, cx, cy = (float(matrix[place]) for place in ((0, 0), (1, 1), (0, 2), (1, 2)))
    camera = PinholeCamera(round(width), round(height), fx, fy, cx, cy)
    with refused(f"{frame.path}: {frame.prefix}", _MEND):
        camera.validate()
    return camera


def front_camera(recordings: Mapping[str, Recording], pose: Array) -> tuple[str, int]:
    """The camera, and its image, that was nearest to a pose (4, 4) of the scene; the first of
    equals."""
    nearest = {
        name: np.linalg.norm((one.poses - pose).reshape(len(one.poses), -1), axis=1)
        for name, one in recordings.items()
    }
    name = min(nearest, key=lambda key: float(nearest[key].min()))
    return name, int(nearest[name].argmin())


def read_unicycle(path: Path) -> tuple[Array, Array]:
    """The motion of an actor: times (T,) in the scene's unit, and poses (T, 4, 4) in the scene.
    Raises InputError: the file is missing, broken or of another layout, a value is not finite, or
    the times do not increase."""
    content = read_torch_file(path, "copy it again", safe=ARRAYS)
    if not isinstance(content, tuple | list) or len(content) != len(MOTION):
        raise InputError(path, "file", f"is not a tuple of {len(MOTION)} members", _MEND)
    table = CheckpointTable(path, dict(zip(MOTION, content, strict=True)))
    times = table.array("train_timestamp").reshape(-1)
    count = len(times)
    if count == 0 or not np.all(np.abs(times) < 1e15) or not np.all(np.diff(times) > 0):
        raise table.fault("train_timestamp", "are not times that increase")
    across, along, height, yaw = (
        _values(table, name, count, 1)[:, 0] for name in ("a", "b", "h", "yaw")
    )
    lean = _values(table, "pitchroll", count, 2)
    # As the published renderer has it: turns about fixed axes, first x, then z, then y.
    angles = math.pi / 2 - np.column_stack([lean, yaw])
    turns = Rotation.from_euler("xzy", angles).as_matrix()
    places = np.column_stack([across, height, along])
    return times, se3.from_rotation_translation(turns, places)


def _values(table: CheckpointTable, name: str, count: int, width: int) -> Array:
    found = table.array(name)
    if found.size != count * width or not np.all(np.abs(found) <= WORLD_REACH):  # also NaN
        raise table.fault(name, f"has no {count * width} values that are finite and in range")
    return found.reshape(count, width)
