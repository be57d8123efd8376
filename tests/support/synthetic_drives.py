"""Small drives made in memory: an ego path driven at a speed, one parked track, no sensors."""

from __future__ import annotations

import numpy as np

from recast.geometry import se2, se3
from recast.logs.types import DrivingLog, Track, Trajectory


def drive(
    speed: float = 10.0,
    seconds: float = 20.0,
    curvature: float = 0.0,
    slope: float = 0.0,
    world_from_start: tuple[float, float, float] = (0.0, 0.0, 0.0),
    size: tuple[float, float, float] = (4.2, 1.8, 1.5),
) -> DrivingLog:
    """A drive along a circle of the given curvature (1/m), climbing by `slope` (rise over run)."""
    times = np.arange(round(seconds * 10) + 1)
    s = speed * times * 0.1
    heading = curvature * s
    if curvature:
        xy = np.stack([np.sin(heading), 1 - np.cos(heading)], axis=-1) / curvature
    else:
        xy = np.stack([s, np.zeros_like(s)], axis=-1)
    poses = se2.compose(world_from_start, np.concatenate([xy, heading[:, None]], axis=1))
    pitch = np.eye(4)
    pitch[:3, 0] = [np.cos(np.arctan(slope)), 0.0, np.sin(np.arctan(slope))]
    pitch[:3, 2] = [-np.sin(np.arctan(slope)), 0.0, np.cos(np.arctan(slope))]
    trajectory = Trajectory(
        (times * 100_000 + 5_000_000).astype(np.int64), se2.to_se3(poses, slope * s) @ pitch
    )
    parked = se3.from_rotation_translation(np.eye(3), [5.0, 40.0, 0.0])
    track = Track(
        "7",
        "car",
        np.array(size),
        Trajectory(trajectory.timestamps_us[[0, -1]], np.stack([parked, parked])),
    )
    other = Track(
        "9",
        "van",
        np.array([5.0, 2.0, 2.0]),
        Trajectory(
            trajectory.timestamps_us[[0, -1]],
            np.stack(
                [
                    se3.from_rotation_translation(np.eye(3), [x, -3.5, 1.0])
                    for x in (0.0, 5.0 * seconds)
                ]
            ),
        ),
    )
    log = DrivingLog(
        name="synthetic",
        cameras={},
        lidars={},
        world_from_rig=trajectory,
        tracks={"7": track, "9": other},
    )
    log.validate()
    return log
