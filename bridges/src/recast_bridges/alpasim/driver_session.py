"""What a driver of AlpaSim is told in a session: vehicle, images, egomotion and route, as messages.

AlpaSim's local frame is recast's world, its rig frame is recast's.
"""

from __future__ import annotations

import logging
from collections.abc import Mapping, Sequence
from typing import TYPE_CHECKING, Any
from uuid import uuid4

import numpy as np
from numpy.typing import ArrayLike

from recast.arrays import Array, Image
from recast.cameras import CameraMount
from recast.core.errors import InputError
from recast.core.workers import Closing
from recast.dynamics import EgoState, initial_state
from recast.dynamics import state as ego
from recast.geometry import se2
from recast.planning import PlannerInput, PlanningContext, ReferenceRoute
from recast.simulation import RoadSurface
from recast_bridges.alpasim.messages import (
    DEADLINE,
    EGODRIVER_METHODS,
    EGODRIVER_SERVICE,
    JPEG_QUALITY,
    PAUSES,
    RefusedError,
    cameras_message,
    encode,
    message,
    pose_message,
)

if TYPE_CHECKING:
    from recast_bridges.alpasim.client import ServiceClient

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
        image_format: `recast_bridges.alpasim.messages.JPEG` or `PNG`.

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


# One session with a driver of AlpaSim: what it is told, what it answers, and its end.
#
# gRPC is imported and a channel opened when a session begins, not earlier: who makes a planner may
# hand it to another process.

_LOG = logging.getLogger(__name__)

_CLOSING = 5.0
"""Seconds that closing a session may take."""
_MENDS = {
    "UNAVAILABLE": "start the driver, or name its host and port",
    "UNIMPLEMENTED": "name the port of a driver (EgodriverService)",
    "DEADLINE_EXCEEDED": "give the driver more time, or check its log",
    "UNKNOWN": "check the driver's log, and name the cameras that it needs",
}
_VERSIONS: dict[str, str] = {}
"""Full version of each driver that this process has met, by address."""


class DriverSession(Closing):
    """A session, from its start to `close`; a context manager.

    Args:
        address: host:port of the driver.
        context: planning context of the rollout.
        cameras: name in `PlannerInput.images` by the driver's name.
        seed: sent to the driver.
        image_format: `recast_bridges.alpasim.messages.JPEG` or `PNG`.
        deadline, pauses: see `ServiceClient`.

    Raises:
        InputError: no driver answers, it refuses the session, or it has another version than before
            in this process.
    """

    def __init__(
        self,
        address: str,
        context: PlanningContext,
        cameras: Mapping[str, str],
        seed: int,
        image_format: int,
        deadline: float = DEADLINE,
        pauses: Sequence[float] = PAUSES,
    ) -> None:
        self.context = context
        self._cameras, self._format = cameras, image_format
        ground = None if context.map is None else context.map.ground
        self._surface = RoadSurface.from_log(context.log, context.route, ground)
        self._told_us = -1  # time of the last pose that the driver was told
        self._uuid = str(uuid4())
        mounts: dict[str, CameraMount] = {
            name: context.cameras[camera] for name, camera in cameras.items()
        }
        self._client = _connected(address, deadline, pauses)
        try:
            self._client.call("start_session", session_request(self._uuid, seed, mounts))
        except BaseException:  # a driver that answered too late has begun it
            self.close()
            raise

    @property
    def step_us(self) -> int:
        """Microseconds between states and between waypoints."""
        return round(self.context.dt * 1e6)

    def tell(self, observation: PlannerInput) -> None:
        """Submit the images, all egomotion since the last time, and the route. Raises InputError: a
        call failed, or an image is too large for a message."""
        uuid, now = self._uuid, observation.timestamp_us
        for name, camera in self._cameras.items():
            try:
                image = image_observation(uuid, name, observation.images[camera], now, self._format)
            except RefusedError as error:
                mend = "render smaller images"
                raise InputError("planner", f"camera {name}", error.details, mend) from None
            self._client.call("submit_image_observation", image)
        times, states = self._new_states(observation)
        poses = self._surface.ego_poses(states[:, ego.POSE])
        self._client.call("submit_egomotion_observation", egomotion(uuid, times, poses, states))
        self._told_us = now
        route = route_request(
            uuid, self.context.route, observation.ego.pose, now, observation.route_s
        )
        self._client.call("submit_route", route)

    def _new_states(self, observation: PlannerInput) -> tuple[list[int], Array]:
        """Times and states (N, 11) since the driver was told; at first, since the log's start."""
        past, step = observation.ego_history, self.step_us
        times = [observation.timestamp_us - step * k for k in range(len(past) - 1, -1, -1)]
        if self._told_us >= 0:
            new = max(sum(time > self._told_us for time in times), 1)
            return times[-new:], past[-new:]
        log, vehicle = self.context.log, self.context.vehicle
        count = (times[0] - int(log.timestamps_us[0])) // step
        earlier = [times[0] - step * k for k in range(count, -1, -1)]  # the last is the first above
        logged = np.stack(
            [initial_state(log.timestamps_us, log.poses, time, vehicle) for time in earlier]
        )
        # A start beside the logged one has its whole past beside it.
        left = float(se2.relative(logged[-1, ego.POSE], past[0, ego.POSE])[1])
        return earlier[:-1] + times, np.concatenate([ego.moved_left(logged[:-1], left), past])

    def drive(self, now_us: int, query_us: int) -> Any:
        """The message DriveResponse.

        Args:
            query_us: time up to which a plan is wanted.

        Raises:
            InputError: the call failed.
        """
        request = message(
            "DriveRequest", session_uuid=self._uuid, time_now_us=now_us, time_query_us=query_us
        )
        return self._client.call("drive", request)

    def close(self) -> None:
        """Close the session and the channel; a fault there is logged: the rollout is over."""
        request = message("DriveSessionCloseRequest", session_uuid=self._uuid)
        try:
            self._client.call("close_session", request, _CLOSING)
        except InputError as error:
            _LOG.warning("%s", error)
        finally:
            self._client.close()


def driver_version(address: str) -> str:
    """What the driver calls itself, with commit and version of the messages if it says them.

    It is asked once in each process.

    Raises:
        InputError: no driver answers.
    """
    if address not in _VERSIONS:
        _connected(address, DEADLINE, PAUSES).close()
    return _VERSIONS[address]


def _connected(address: str, deadline: float, pauses: Sequence[float]) -> ServiceClient:
    """A client of the driver; all results of one process are of one version."""
    try:
        from recast_bridges.alpasim.client import ServiceClient
    except ModuleNotFoundError:
        mend = "pip install 'recast-sim[alpasim]'"
        raise InputError("grpcio", "module", "is not installed", mend) from None
    client = ServiceClient(
        address,
        EGODRIVER_METHODS,
        (EGODRIVER_SERVICE,),
        deadline=deadline,
        pauses=pauses,
        mends=_MENDS,
    )
    known = _VERSIONS.setdefault(address, client.full_version)
    if known != client.full_version:
        client.close()
        problem = f"the driver is now {client.full_version}, but was {known} before"
        raise InputError(
            address, "get_version", problem, "run again with the same driver throughout"
        )
    return client
