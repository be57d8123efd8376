"""nuScenes boxes: annotations of key frames into tracks."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path

import numpy as np

from recast.errors import InputError
from recast.logs import checks
from recast.logs.importers.nuscenes_sensors import pose_of
from recast.logs.importers.nuscenes_tables import (
    AnnotationRow,
    CategoryRow,
    InstanceRow,
    SampleRow,
    linked,
    select,
)
from recast.logs.types import Array, Track, Trajectory

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
_MEND = "take all tables from one metadata archive"


def read_tracks(
    tables: Path, samples: Sequence[SampleRow], world_from_rig: Trajectory, offset: Array
) -> dict[str, Track]:
    """Tracks by instance token, posed at key frames and ten times a second between them.

    Poses between two key frames in a row that both show the object are interpolated, positions
    linearly and turns by slerp. Over a key frame without a box nothing is filled in.

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
                f"{kind.name!r} is none of nuScenes",
                f"use one of {', '.join(CATEGORIES)}",
            )
    grouped: dict[str, dict[int, AnnotationRow]] = {}
    for box in boxes:
        of_instance = grouped.setdefault(box.instance_token, {})
        time = times[box.sample_token]
        if time in of_instance:
            field = f"token {box.token}: sample_token"
            problem = f"a second box of instance {box.instance_token} at one key frame"
            raise InputError(path, field, problem, _MEND)
        of_instance[time] = box
    in_order = np.array(sorted(times.values()), np.int64)
    ends = dict(zip(in_order[:-1].tolist(), in_order[1:].tolist(), strict=True))
    return {
        token: _track(path, token, category, grouped[token], ends, world_from_rig, offset)
        for token in grouped
        if (category := CATEGORIES.get(kinds[instances[token].category_token].name)) is not None
    }


def _track(
    path: Path,
    token: str,
    category: str,
    boxes: dict[int, AnnotationRow],
    ends: dict[int, int],
    world_from_rig: Trajectory,
    offset: Array,
) -> Track:
    """The track of one instance.

    Args:
        boxes: by the time of their key frame.
        ends: of the interval that begins at a key frame.
    """
    times = np.array(sorted(boxes), np.int64)
    ordered = [boxes[int(time)] for time in times]
    poses = np.stack([pose_of(path, box) for box in ordered])
    poses[:, :3, 3] -= offset
    away = np.linalg.norm(poses[:, :3, 3] - world_from_rig.at(times)[:, :3, 3], axis=1)
    for box, distance in zip(ordered, away, strict=True):
        if not checks.are_box_sides(box.size).all():
            problem = f"is {box.size}, not a box's"
            raise InputError(path, f"token {box.token}: size", problem, "remove the box")
        if distance > _FARTHEST:
            problem = f"the box is {distance:.0f} m from the ego: mixed coordinate frames"
            raise InputError(path, f"token {box.token}: translation", problem, _MEND)
    width, length, height = np.median([box.size for box in ordered], axis=0)
    at_keys = Trajectory(times, poses)
    between = [
        start + (end - start) * step // STEPS
        for start in times.tolist()
        if (end := ends.get(start)) in boxes
        for step in range(1, STEPS)
    ]
    filled = np.sort(np.append(times, np.array(between, np.int64)))
    size = np.array([length, width, height])
    return Track(token, category, size, Trajectory(filled, at_keys.at(filled)))
