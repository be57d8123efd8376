"""Which tracks become actors, and where they are at a camera's time."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import replace

import numpy as np
from numpy.typing import NDArray
from scipy.spatial.transform import Rotation

from recast.arrays import Array
from recast.cameras import box_rectangle
from recast.core.errors import InputError
from recast.logs import DrivingLog, Track, Trajectory, all_track_points
from recast.scene.config import SceneConfig
from recast.scene.views import TrainingView, read_places

DEFORMABLE = frozenset({"pedestrian"})
"""Categories that are not symmetric at every moment."""
ARTICULATED = frozenset({"pedestrian", "cyclist"})
"""Categories that have limbs: what deformable nodes are for."""
MOVED_M = 2.0
SPREAD_M = 0.5
PARKED_US = 1_000_000
"""Microseconds of labels, without which standing still cannot be told from moving slowly."""
PARKED_VIEWS, PARKED_PIXELS, PARKED_POINTS = 3, 16, 50
CLOCK_TOLERANCE_US = 60_000
"""Sensors of one frame fire up to half a period of 10 Hz (and a little) apart."""


def moves(trajectory: Trajectory) -> bool:
    """Whether a track counts as moving in the world.

    First and last position more than 2 m apart, or a spread along an axis above 0.5 m (Street
    Gaussians' rule), the first so that label noise of parked cars does not count.
    """
    positions = trajectory.poses[:, :3, 3]
    travelled = float(np.linalg.norm(positions[-1] - positions[0]))
    return travelled > MOVED_M or bool(np.any(positions.std(axis=0) > SPREAD_M))


def stands(trajectory: Trajectory) -> bool:
    """Whether every pose is the same, as `choose_actors` makes those of parked vehicles."""
    return bool(np.all(trajectory.poses == trajectory.poses[:1]))


def deforms(track: Track, config: SceneConfig) -> bool:
    """Whether an actor is a deformable node: with `deformable`, people and cyclists that move."""
    moving = not stands(track.trajectory)
    return config.deformable and track.category in ARTICULATED and moving


def pose_at(trajectory: Trajectory, timestamp_us: int) -> Array | None:
    """World pose (4, 4) at a time, or None where the track is absent.

    Interpolated in the world frame. A camera that fires shortly before the first or after the last
    label still saw the object: there the end pose is held.
    """
    first, last = int(trajectory.timestamps_us[0]), int(trajectory.timestamps_us[-1])
    if not first - CLOCK_TOLERANCE_US <= timestamp_us <= last + CLOCK_TOLERANCE_US:
        return None
    return trajectory.at(min(max(timestamp_us, first), last))


def visible_rectangle(size: Array, world_from_box: Array, view: TrainingView) -> Array | None:
    """Image rectangle (left, top, right, bottom) of a box, clipped to the image; None if unseen."""
    camera = view.camera
    rectangle = box_rectangle(size, view.camera_from_world @ world_from_box, camera)
    if rectangle is None:
        return None
    limits = [camera.width, camera.height, camera.width, camera.height]
    clipped: Array = np.clip(rectangle, 0, limits)
    if clipped[2] - clipped[0] < 1 or clipped[3] - clipped[1] < 1:
        return None
    return clipped


def choose_actors(
    log: DrivingLog, views: Sequence[TrainingView], config: SceneConfig
) -> Mapping[str, Track]:
    """Tracks that get a model of their own: moving, parked or forced ones.

    A moving or forced track is one that is seen in at least one view. A parked vehicle is one that
    was labelled for `PARKED_US` and seen well enough: by `PARKED_VIEWS` views in which its box is
    `PARKED_PIXELS` wide and high, and where there is a LiDAR, by `PARKED_POINTS` points. It stands
    at the median of its labels from the log's first pose to its last, since labels of what stands
    still differ by their noise alone.

    Raises:
        InputError: a forced or excluded track is not in the log, or a forced one is never visible.
    """
    for field in ("force_dynamic", "exclude_tracks"):
        for track_id in getattr(config, field):
            if track_id not in log.tracks:
                raise InputError(
                    log.name,
                    f"{field}: track {track_id}",
                    "is not in the log",
                    f"choose one of {', '.join(sorted(log.tracks)) or 'none'}",
                )
    parked = _parked(log, views, config)
    chosen = {}
    for track_id, track in log.tracks.items():
        if track_id in config.exclude_tracks:
            continue
        forced = track_id in config.force_dynamic
        if track_id in parked:
            chosen[track_id] = parked[track_id]
        elif not (forced or moves(track.trajectory)):
            continue
        elif any(_rectangle(track, view) is not None for view in views):
            chosen[track_id] = track
        elif forced:
            raise InputError(
                log.name,
                f"force_dynamic: track {track_id}",
                "is never visible in the cameras used",
                "choose another track or other cameras",
            )
    return chosen


def modelled_tracks(log: DrivingLog, config: SceneConfig) -> frozenset[str]:
    """Ids of the tracks that a scene of this configuration models, see `choose_actors`."""
    return frozenset(choose_actors(log, read_places(log, config), config))


def _parked(
    log: DrivingLog, views: Sequence[TrainingView], config: SceneConfig
) -> dict[str, Track]:
    candidates = {
        track_id: track
        for track_id, track in log.tracks.items()
        if track.category not in DEFORMABLE
        and not moves(track.trajectory)
        and np.ptp(track.trajectory.timestamps_us) >= PARKED_US
        and _seen_well(track, views)
    }
    if log.lidars and candidates:
        points = all_track_points(log, candidates)
        candidates = {k: t for k, t in candidates.items() if len(points[k].points) >= PARKED_POINTS}
    ends = log.world_from_rig.timestamps_us[[0, -1]]
    return {
        key: replace(track, trajectory=_standing(track.trajectory, ends))
        for key, track in candidates.items()
    }


def _standing(trajectory: Trajectory, ends: NDArray[np.int64]) -> Trajectory:
    """The median pose, at the first and the last time."""
    pose = trajectory.poses[0].copy()
    pose[:3, 3] = np.median(trajectory.poses[:, :3, 3], axis=0)
    pose[:3, :3] = Rotation.from_matrix(trajectory.poses[:, :3, :3]).mean().as_matrix()
    return Trajectory(ends.copy(), np.stack([pose, pose]))


def _seen_well(track: Track, views: Sequence[TrainingView]) -> bool:
    rectangles = (_rectangle(track, view) for view in views if not view.held_out)
    sides = [np.ptp(one.reshape(2, 2), axis=0) for one in rectangles if one is not None]
    return sum(bool(np.all(side >= PARKED_PIXELS)) for side in sides) >= PARKED_VIEWS


def _rectangle(track: Track, view: TrainingView) -> Array | None:
    pose = pose_at(track.trajectory, view.timestamp_us)
    return None if pose is None else visible_rectangle(track.size, pose, view)
