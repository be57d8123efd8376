"""From where the log saw a vehicle, and how far from there a new view lies."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from recast.actors.view_score import score_frame
from recast.geometry import se3
from recast.logs import DrivingLog, Track

Array = NDArray[np.float64]

MAX_DISTANCE = 60.0
"""Metres beyond which a camera tells nothing of a vehicle's sides."""
MIN_SIZE_PX = 16.0
"""Geometric mean of the sides of the box's rectangle, in pixels of the logged image."""
MIN_SEEN = 0.25
"""Share of the box that must lie in the image, and that no other labelled box may hide."""


def view_direction(world_from_actor: Array, world_from_camera: Array) -> Array:
    """Unit vector (3,) from a vehicle's box centre to a camera, in the actor frame."""
    eye: Array = se3.apply(se3.inverse(world_from_actor), world_from_camera[None, :3, 3])[0]
    direction: Array = eye / np.linalg.norm(eye)
    return direction


def logged_views(log: DrivingLog, track: Track) -> Array:
    """Directions (N, 3), actor to camera in the actor frame, of the images that show a vehicle.

    An image counts where the projected box is at least 16 px in size, within 60 m, and at least a
    quarter of it is in the image and not behind other labelled boxes. This is generous: a view
    that is far from all of these is one that the log does not have.
    """
    directions = []
    for stream in log.cameras.values():
        for frame in range(len(stream.timestamps_us)):
            score = score_frame(log, track, stream, frame)
            if score is None or score.size_px < MIN_SIZE_PX:
                continue
            if min(score.in_image, score.unoccluded) < MIN_SEEN:
                continue
            time = score.timestamp_us
            world_from_actor = track.trajectory.at(time)
            world_from_camera = log.world_from_rig.at(time) @ stream.rig_from_camera
            if np.linalg.norm((world_from_camera - world_from_actor)[:3, 3]) <= MAX_DISTANCE:
                directions.append(view_direction(world_from_actor, world_from_camera))
    return np.array(directions).reshape(-1, 3)


def angle_to_nearest(direction: Array, logged: Array) -> float:
    """Degrees from a unit direction (3,) to the nearest of `logged` (N, 3), N >= 1."""
    nearest = logged[np.argmax(logged @ direction)]
    # atan2 rather than arccos: exact where the directions are alike
    cross = np.linalg.norm(np.cross(direction, nearest))
    return float(np.degrees(np.arctan2(cross, direction @ nearest)))


def azimuth_elevation(direction: Array) -> tuple[float, float]:
    """Degrees: azimuth 0 ahead of the vehicle and 90 to its left; elevation above its horizon."""
    x, y, z = direction
    return float(np.degrees(np.arctan2(y, x))), float(np.degrees(np.arcsin(np.clip(z, -1, 1))))
