"""Labels as people draw them: not quite where the vehicle is."""

from __future__ import annotations

from collections.abc import Mapping

import numpy as np

from recast.errors import InputError
from recast.geometry import se3
from recast.logs import Track, Trajectory
from recast.synthetic.rig import sensor_number

_STREAM = 401
_HEIGHT_SHARE = 0.3
"""Of the noise in height: the ground tells an annotator where a box stands."""
_LEAST_SIZE = 0.5


def check_label_noise(metres: float) -> None:
    """Refuse impossible noise.

    Raises:
        InputError: negative, or not a number.
    """
    if not 0 <= metres < np.inf:
        raise InputError("label noise", f"{metres:g} m", "is impossible", "choose 0 or more metres")


def with_label_noise(tracks: Mapping[str, Track], metres: float, seed: int) -> dict[str, Track]:
    """Tracks with independent normal errors in every label, and one error of size a track.

    Args:
        metres: standard deviation of each coordinate on the ground, and of length and width; the
            yaw's moves the ends of the box by as much.
    """
    check_label_noise(metres)
    if metres == 0:
        return dict(tracks)
    return {key: _noisy(track, metres, seed) for key, track in tracks.items()}


def _noisy(track: Track, metres: float, seed: int) -> Track:
    rng = np.random.default_rng([seed, _STREAM, sensor_number(track.track_id)])
    scale = np.array([1.0, 1.0, _HEIGHT_SHARE]) * metres
    size = np.maximum(track.size + scale * rng.normal(size=3), _LEAST_SIZE * track.size)
    poses = track.trajectory.poses.copy()
    poses[:, :3, 3] += scale * rng.normal(size=(len(poses), 3))
    yaw = metres / (track.size[0] / 2) * rng.normal(size=len(poses))
    poses[:, :3, :3] = poses[:, :3, :3] @ se3.rotation_z(yaw)
    trajectory = Trajectory(track.trajectory.timestamps_us, poses)
    return Track(track.track_id, track.category, size, trajectory)
