"""A log of a few images and points, for tests of the store."""

from __future__ import annotations

import numpy as np

from recast.cameras import PinholeCamera
from recast.geometry import se3
from recast.logs import CameraStream, DrivingLog, LidarStream, LidarSweep, Track, Trajectory


def small_log(rng: np.random.Generator) -> DrivingLog:
    """A log of random numbers: nothing in it is symmetric or zero by chance."""
    times = 1_700_000_000_000_000 + 100_000 * np.arange(6, dtype=np.int64)
    ego = Trajectory(times, se3.exp(rng.normal(0, 0.3, (6, 6))))
    camera = PinholeCamera(7, 5, 6.123456789, 6.2, 3.4, 2.6, (0.1, -0.02, 1e-3, -2e-3, 3e-3))
    images = rng.integers(0, 256, (3, 5, 7, 3), dtype=np.uint8)
    mask = rng.random((5, 7)) > 0.3
    mount = se3.exp(rng.normal(0, 0.5, 6))
    points = rng.normal(0, 20, (2, 50, 3)).astype(np.float32)
    sweeps = [
        LidarSweep(int(times[1]), points[0], rng.random(50).astype(np.float32)),
        LidarSweep(
            int(times[3]),
            points[1],
            rng.random(50).astype(np.float32),
            times[3] + rng.integers(-50_000, 50_000, 50),
        ),
    ]
    track = Track(
        "car 7",
        "car",
        np.array([4.1, 1.8, 1.5]),
        Trajectory(times[1:4], se3.exp(rng.normal(size=(3, 6)))),
    )
    return DrivingLog(
        name="small",
        cameras={"front": CameraStream("front", camera, mount, times[[0, 2, 5]], images, mask)},
        lidars={"top": LidarStream("top", se3.inverse(mount), times[[1, 3]], sweeps)},
        world_from_rig=ego,
        tracks={"car 7": track},
        world_offset=rng.normal(0, 1e6, 3),
        metadata={"licence": "none"},
    )
