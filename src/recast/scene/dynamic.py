"""Which tracks become actors, and where they are at a camera's time."""

from __future__ import annotations

from collections.abc import Mapping, Sequence

import numpy as np
from numpy.typing import NDArray

from recast.errors import InputError
from recast.geometry import boxes
from recast.logs import DrivingLog, Track, Trajectory
from recast.scene.config import SceneConfig
from recast.scene.views import View

Array = NDArray[np.float64]

MOVED_M = 2.0
SPREAD_M = 0.5
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


def pose_at(trajectory: Trajectory, timestamp_us: int) -> Array | None:
    """World pose (4, 4) at a time, or None where the track is absent.

    Interpolated in the world frame. A camera that fires shortly before the first or after the last
    label still saw the object: there the end pose is held.
    """
    first, last = int(trajectory.timestamps_us[0]), int(trajectory.timestamps_us[-1])
    if not first - CLOCK_TOLERANCE_US <= timestamp_us <= last + CLOCK_TOLERANCE_US:
        return None
    return trajectory.at(min(max(timestamp_us, first), last))


def box_rectangle(size: Array, world_from_box: Array, view: View) -> Array | None:
    """Image rectangle (left, top, right, bottom) of a box, clipped to the image; None if unseen."""
    camera = view.camera
    rectangle = boxes.project(size, view.camera_from_world @ world_from_box, camera)
    if rectangle is None:
        return None
    limits = [camera.width, camera.height, camera.width, camera.height]
    clipped: Array = np.clip(rectangle, 0, limits)
    if clipped[2] - clipped[0] < 1 or clipped[3] - clipped[1] < 1:
        return None
    return clipped


def choose_actors(
    log: DrivingLog, views: Sequence[View], config: SceneConfig
) -> Mapping[str, Track]:
    """Tracks that get a model of their own: moving or forced, and seen in at least one view.

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
                    f"choose of {', '.join(sorted(log.tracks)) or 'none'}",
                )
    chosen = {}
    for track_id, track in log.tracks.items():
        forced = track_id in config.force_dynamic
        if track_id in config.exclude_tracks or not (forced or moves(track.trajectory)):
            continue
        if any(_visible(track, view) for view in views):
            chosen[track_id] = track
        elif forced:
            raise InputError(
                log.name,
                f"force_dynamic: track {track_id}",
                "is never visible in the cameras used",
                "choose another track or other cameras",
            )
    return chosen


def _visible(track: Track, view: View) -> bool:
    pose = pose_at(track.trajectory, view.timestamp_us)
    return pose is not None and box_rectangle(track.size, pose, view) is not None
