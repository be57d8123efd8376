"""What a driver of AlpaSim is told in a session: vehicle, images, egomotion and route, as messages.

AlpaSim's local frame is recast's world, its rig frame is recast's.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import Any

import numpy as np
from numpy.typing import ArrayLike

from recast.arrays import Array, Image
from recast.cameras import CameraMount
from recast.dynamics import EgoState
from recast.geometry import se2
from recast.planning import ReferenceRoute
from recast_bridges.alpasim.cameras import cameras_message
from recast_bridges.alpasim.messages import message
from recast_bridges.alpasim.poses import pose_message
from recast_bridges.alpasim.requests import JPEG_QUALITY, encode

ROUTE_POINTS = 20
ROUTE_REACH = 80.0
"""Metres ahead at which the last point of a route lies."""


def session_request(session: str, seed: int, mounts: Mapping[str, CameraMount]) -> Any:
    """The message DriveSessionRequest. It does not name the scene: drivers drive without that.

    Args:
        mounts: cameras of the images to come, by the driver's names.
    """
    cameras = cameras_message(mounts).available_cameras
    vehicle = message("VehicleDefinition", available_cameras=cameras)
    spec = message("RolloutSpec", vehicle=vehicle)
    return message("DriveSessionRequest", session_uuid=session, random_seed=seed, rollout_spec=spec)


def image_observation(
    session: str, camera: str, image: Image, timestamp_us: int, image_format: int
) -> Any:
    """The message RolloutCameraImage of an image (H, W, 3) taken at one moment.

    Its frame ends now, and begins a microsecond earlier: frames of no length are none in AlpaSim.

    Args:
        image_format: `recast_bridges.alpasim.requests.JPEG` or `PNG`.

    Raises:
        RefusedError: no message can hold it.
    """
    taken = message(
        "CameraImage",
        frame_start_us=timestamp_us - 1,
        frame_end_us=timestamp_us,
        image_bytes=encode(image, image_format, JPEG_QUALITY),
        logical_id=camera,
    )
    return message("RolloutCameraImage", session_uuid=session, camera_image=taken)


def egomotion(
    session: str, timestamps_us: Sequence[int], local_from_rig: Array, states: Array
) -> Any:
    """The message RolloutEgoTrajectory.

    Args:
        timestamps_us: times of the N poses, rising.
        local_from_rig: (N, 4, 4).
        states: (N, 11) columns of `recast.dynamics.state`.
    """
    poses = [
        message("PoseAtTime", pose=pose_message(pose), timestamp_us=time)
        for time, pose in zip(timestamps_us, local_from_rig, strict=True)
    ]
    return message(
        "RolloutEgoTrajectory",
        session_uuid=session,
        trajectory=message("Trajectory", poses=poses),
        dynamic_states=[_dynamic_state(EgoState(state)) for state in states],
    )


def _dynamic_state(state: EgoState) -> Any:
    """Velocities and accelerations in the rig frame.

    The simulated state has no acceleration to the left; it is the centripetal one, as recordings
    have it.
    """
    turn = state.angular_velocity
    return message(
        "DynamicState",
        angular_velocity=message("Vec3", z=turn),
        linear_velocity=message("Vec3", x=state.vx, y=state.vy),
        linear_acceleration=message("Vec3", x=state.ax, y=state.vx * turn),
        angular_acceleration=message("Vec3", z=state.angular_acceleration),
    )


def route_request(
    session: str,
    route: ReferenceRoute,
    pose: ArrayLike,
    timestamp_us: int,
    route_s: float | None = None,
) -> Any:
    """The message RouteRequest: 20 points from beside the ego to 80 m ahead, in the rig frame.

    Points beyond the end of the route are NaN.

    Args:
        pose: (3,) x, y, heading of the ego, world.
        route_s: see `PlannerInput.route_s`.
    """
    here = max(float(route.project(pose, route_s)[0]), 0.0)
    along = here + np.linspace(0.0, ROUTE_REACH, ROUTE_POINTS)
    points = se2.relative(pose, route.pose(along))[:, :2]
    points[along > route.length] = np.nan
    waypoints = [
        message("Vec3", x=x, y=y, z=0.0 if np.isfinite(x) else np.nan) for x, y in points.tolist()
    ]
    told = message("Route", waypoints=waypoints, timestamp_us=timestamp_us)
    return message("RouteRequest", session_uuid=session, route=told)
