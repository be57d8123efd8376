"""NAVSIM's cameras and data classes, by its field names, for agents that do not import the package.

Frames: x forward, y left, heading counter-clockwise, rear axle; metres, radians, seconds. Histories
are half a second apart, oldest first, the present last.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from typing import Any

import numpy as np
from numpy.typing import NDArray

from recast.cameras import CameraMount
from recast.cameras.mounts import WITHIN_DEGREES, Look, directions, match_cameras
from recast.core.errors import InputError

NAVSIM_CAMERAS: Mapping[str, float] = {
    "cam_f0": 0.0,
    "cam_l0": 55.0,
    "cam_l1": 110.0,
    "cam_l2": 145.0,
    "cam_r0": -55.0,
    "cam_r1": -110.0,
    "cam_r2": -145.0,
    "cam_b0": 180.0,
}
"""By name the direction in which nuPlan's camera looks, rounded: degrees to the left of ahead."""

NUPLAN_RIG: Mapping[str, str] = {
    "cam_l0": "nuplan_l0",
    "cam_f0": "nuplan_f0",
    "cam_r0": "nuplan_r0",
}
"""For `NavsimPlanner(cameras=...)`: nuPlan's own cameras, rendered for agents that need them."""

_FIELD = 63.7
"""Horizontal field of view of nuPlan's cameras, degrees, between the edges of a pinhole image."""
HISTORY_FRAMES = 4
"""Frames that an agent is shown: 1.5 s, 1.0 s and 0.5 s ago, and the present."""

HISTORY_INTERVAL = 0.5
"""Seconds between them."""


@dataclass
class EgoStatus:
    """The ego at one frame.

    Attributes:
        ego_pose: (3,) x, y, heading in the PRESENT ego frame; zero in the last frame.
        ego_velocity: (2,) vx, vy in the ego frame of that moment, m/s.
        ego_acceleration: (2,) ax, ay likewise, m/s^2; ay contains the centripetal part.
        driving_command: (4,) one-hot left, straight, right, unknown.
        in_global_frame: whether poses are in the global frame; False for agents.
    """

    ego_pose: NDArray[np.float32]
    ego_velocity: NDArray[np.float32]
    ego_acceleration: NDArray[np.float32]
    driving_command: NDArray[np.int64]
    in_global_frame: bool = False


@dataclass
class Camera:
    """One camera image; all None where the agent did not ask for it.

    Attributes:
        image: (H, W, 3) uint8 RGB.
        sensor2lidar_rotation, sensor2lidar_translation: (3, 3) and (3,), OpenCV camera frame to the
            LiDAR's. No LiDAR is simulated: its frame is taken to be the ego's.
        intrinsics: (3, 3) camera matrix with pixel centres at whole numbers, as OpenCV counts.
        distortion: (5,) coefficients k1, k2, p1, p2, k3.
    """

    image: NDArray[np.uint8] | None = None
    sensor2lidar_rotation: NDArray[np.float64] | None = None
    sensor2lidar_translation: NDArray[np.float64] | None = None
    intrinsics: NDArray[np.float64] | None = None
    distortion: NDArray[np.float64] | None = None


@dataclass
class Cameras:
    """The eight cameras at one frame: front, left, right and back."""

    cam_f0: Camera
    cam_l0: Camera
    cam_l1: Camera
    cam_l2: Camera
    cam_r0: Camera
    cam_r1: Camera
    cam_r2: Camera
    cam_b0: Camera


@dataclass
class Lidar:
    """A point cloud; None here, always."""

    lidar_pc: NDArray[np.float32] | None = None


@dataclass
class AgentInput:
    """What an agent sees: four frames of each, the present one last."""

    ego_statuses: list[EgoStatus]
    cameras: list[Cameras]
    lidars: list[Lidar]


@dataclass
class SensorConfig:
    """What an agent wants to see: for each sensor True, False, or a list of frames (0 .. 3)."""

    cam_f0: bool | list[int] = False
    cam_l0: bool | list[int] = False
    cam_l1: bool | list[int] = False
    cam_l2: bool | list[int] = False
    cam_r0: bool | list[int] = False
    cam_r1: bool | list[int] = False
    cam_r2: bool | list[int] = False
    cam_b0: bool | list[int] = False
    lidar_pc: bool | list[int] = False

    @classmethod
    def build_all_sensors(cls, include: bool | list[int] = True) -> SensorConfig:
        """All cameras and the LiDAR."""
        return cls(**dict.fromkeys((*NAVSIM_CAMERAS, "lidar_pc"), include))

    @classmethod
    def build_no_sensors(cls) -> SensorConfig:
        """None."""
        return cls()


@dataclass
class TrajectorySampling:
    """When the poses of a trajectory are: any two of the three say the third."""

    num_poses: int | None = None
    time_horizon: float | None = None
    interval_length: float | None = None

    def __post_init__(self) -> None:
        """Work out the missing one. Raises ValueError: fewer than two are given, or they contradict
        each other."""
        count, horizon, interval = self.num_poses, self.time_horizon, self.interval_length
        if (count, horizon, interval).count(None) > 1:
            raise ValueError("TrajectorySampling: give two of its three values")
        if interval is None and horizon is not None and count is not None:
            interval = self.interval_length = horizon / count
        if count is None and horizon is not None and interval is not None:
            count = self.num_poses = round(horizon / interval)
        if horizon is None and count is not None and interval is not None:
            horizon = self.time_horizon = count * interval
        assert count is not None and horizon is not None and interval is not None
        if abs(count * interval - horizon) > 1e-6:
            raise ValueError(
                f"TrajectorySampling: {count} poses every {interval:g} s are not {horizon:g} s"
            )


@dataclass
class Trajectory:
    """An agent's answer.

    Attributes:
        poses: (num_poses, 3) x, y, heading in the present ego frame; the present pose, all zero, is
            not among them.
        trajectory_sampling: times of the poses.
    """

    poses: Any
    trajectory_sampling: TrajectorySampling = field(
        default_factory=lambda: TrajectorySampling(time_horizon=4.0, interval_length=0.5)
    )


def rig_cameras(
    wanted: Sequence[str], mounts: Mapping[str, CameraMount], where: str
) -> dict[str, str]:
    """NAVSIM name to the rig's camera, see `match_cameras`; `where` is who asks, for messages.
    Raises InputError: no camera looks where a wanted one should."""
    found = match_cameras(
        {name: Look.level(NAVSIM_CAMERAS[name], _FIELD) for name in wanted}, mounts
    )
    for name in wanted:
        if name not in found:
            raise InputError(
                where,
                f"camera {name}",
                f"is needed, but no unused camera looks within {WITHIN_DEGREES:g} degrees of "
                f"{NAVSIM_CAMERAS[name]:.0f} (left of ahead)",
                f"use another log, or name other cameras; there are {directions(mounts)}",
            )
    return found
