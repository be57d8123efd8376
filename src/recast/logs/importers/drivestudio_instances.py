"""DriveStudio's instances_info.json: boxes in global coordinates into tracks."""

from __future__ import annotations

from pathlib import Path
from typing import Literal

import numpy as np
from pydantic import BaseModel, ConfigDict, ValidationError

from recast import storage
from recast.errors import InputError
from recast.logs import checks
from recast.logs.importers.processed_folder import FARTHEST, rigid
from recast.logs.types import Array, Track, Trajectory
from recast.records import validation_error

CATEGORIES = {"Vehicle": "car", "Pedestrian": "pedestrian", "Cyclist": "cyclist"}
_MEND = "process the scene again"

_Four = tuple[float, float, float, float]


class _Model(BaseModel):
    model_config = ConfigDict(extra="ignore", allow_inf_nan=False)


class _Boxes(_Model):
    frame_idx: list[int]
    obj_to_world: list[tuple[_Four, _Four, _Four, _Four]]
    box_size: list[tuple[float, float, float]]


class _Instance(_Model):
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
    value = storage.read_json(path)
    if not isinstance(value, dict):
        raise InputError(path, "JSON", "is no object", _MEND)
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
        raise InputError(path, field, "frame_idx, obj_to_world, box_size differ in length", _MEND)
    unknown = next((frame for frame in boxes.frame_idx if frame not in frame_times), None)
    if unknown is not None:
        problem = f"{unknown} has no file in ego_pose"
        raise InputError(path, f"{field}.frame_idx", problem, "take the boxes of this scene")
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
        raise InputError(path, f"{field}.box_size.{i}", "is not a box's", "remove the box")
    category = CATEGORIES[instance.class_name]
    return Track(name, category, np.median(size, axis=0), Trajectory(times, poses))
