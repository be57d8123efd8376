"""A driver of AlpaSim that refuses whatever the protocol does not allow, and drives by a rule.

It is written from the protocol's description, not from recast's client. As a program
(`python -m support.fake_driver PORT`) it prints its port and serves until it is killed.
"""

from __future__ import annotations

import sys
import time
from collections.abc import Callable, Iterator, Mapping, Sequence
from concurrent.futures import ThreadPoolExecutor
from contextlib import contextmanager
from dataclasses import dataclass, field
from threading import Lock
from typing import Any

import cv2
import grpc
import numpy as np

from recast.geometry import se2
from recast.planning.simple import arc
from recast_bridges.alpasim.messages import (
    EGODRIVER_METHODS,
    message,
    parse,
    pose_message,
    read_pose,
)

VERSION = "fake-driver-1"
STEP_US = 100_000
_SPEED_TOLERANCE = 0.5
"""Metres per second between displacement over time and the velocity that is told with it."""


class Refused(Exception):  # noqa: N818
    """A call that ends with a status."""

    def __init__(self, code: grpc.StatusCode, details: str) -> None:
        self.code, self.details = code, details
        super().__init__(details)


def require(holds: bool, details: str) -> None:
    """What AlpaSim's driver answers to bad input of its model."""
    if not holds:
        raise Refused(grpc.StatusCode.FAILED_PRECONDITION, details)


@dataclass
class Session:
    """What a driver was told."""

    sizes: dict[str, tuple[int, int]]
    images: dict[str, np.ndarray] = field(default_factory=dict)
    image_times: dict[str, int] = field(default_factory=dict)
    poses: list[tuple[int, np.ndarray]] = field(default_factory=list)
    velocity: tuple[float, float] = (0.0, 0.0)
    route: np.ndarray | None = None
    route_us: int = -1
    driven_us: int = -1


Rule = Callable[[np.ndarray, float, np.ndarray, Mapping[str, np.ndarray]], list[np.ndarray]]
"""Local-from-rig poses at 0, 0.1, ... 4 s from the present one, the speed, the route (20, 3) in the
rig frame, and the images."""


def follow(
    local_from_rig: np.ndarray,
    speed: float,
    route: np.ndarray,
    images: Mapping[str, np.ndarray],
) -> list[np.ndarray]:
    """An arc through the first point of the route beyond 12 m; slower if the images are dark."""
    for image in images.values():
        speed *= 0.8 + 0.4 * float(image.mean()) / 255.0
    far = route[np.hypot(route[:, 0], route[:, 1]) > 12.0]  # NaN is not
    curvature = 0.0
    if len(far):
        x, y = far[0, :2]
        curvature = 2.0 * y / (x * x + y * y)
    offsets = arc(curvature, speed * 0.1 * np.arange(41))
    return [local_from_rig @ se2.to_se3(offset) for offset in offsets]


class FakeDriver:
    """The methods of the service.

    Args:
        cameras: that it uses; None for all that it is offered.
        rule: how it drives.
        version: version_id that it answers with.
        change: makes another DriveResponse of one, given the number of the drive in the session.
    """

    def __init__(
        self,
        cameras: Sequence[str] | None = None,
        rule: Rule = follow,
        version: str = VERSION,
        change: Callable[[Any, int], Any] = lambda reply, number: reply,
    ) -> None:
        self.cameras, self.rule, self.version, self.change = cameras, rule, version, change
        self.sessions: dict[str, Session] = {}
        self.calls: list[str] = []
        self.refused: list[str] = []
        self.drives: dict[str, int] = {}
        self.told: list[Any] = []
        self._lock = Lock()

    def answer(self, method: str, data: bytes) -> bytes:
        """The reply to a request, both encoded."""
        with self._lock:
            self.calls.append(method)
            request = parse(EGODRIVER_METHODS[method][0], data)
            self.told.append(request)
            try:
                reply = getattr(self, method)(request)
            except Refused as refused:
                self.refused.append(refused.details)
                raise
        if method == "drive":  # without the lock: it may take long
            reply = self.change(reply, self.drives[request.session_uuid])
        if isinstance(reply, bytes):
            return reply
        return reply.SerializeToString()  # type: ignore[no-any-return]

    def get_version(self, request: Any) -> Any:
        api = message("ApiVersion", minor=54)
        return message("VersionId", version_id=self.version, git_hash="abc", grpc_api_version=api)

    def start_session(self, request: Any) -> Any:
        key = request.session_uuid
        require(key != "", "no session_uuid")
        if key in self.sessions:
            raise Refused(grpc.StatusCode.ALREADY_EXISTS, f"Session {key} already exists.")
        require(not request.HasField("debug_info"), "debug_info tells the scene")
        require(request.rollout_spec.HasField("vehicle"), "no vehicle")
        sizes = {}
        for camera in request.rollout_spec.vehicle.available_cameras:
            spec = camera.intrinsics
            require(camera.logical_id not in ("", *sizes), "logical_id empty or there twice")
            require(spec.logical_id == camera.logical_id, "intrinsics of another camera")
            require(spec.HasField("opencv_pinhole_param"), "no camera model")
            pose = read_pose(camera.rig_to_camera, "rig_to_camera")
            require(pose[2, 3] > 0.3, "rig_to_camera: the camera lies on the ground")
            require(abs(pose[2, 1] + 1.0) < 0.2, "rig_to_camera: y does not point down")
            sizes[camera.logical_id] = spec.resolution_w, spec.resolution_h
        missing = sorted(set(self.cameras or ()) - set(sizes))
        if missing:
            text = f"Requested cameras {missing} are missing from the rollout spec"
            raise Refused(grpc.StatusCode.UNKNOWN, text)
        wanted = sizes if self.cameras is None else {name: sizes[name] for name in self.cameras}
        self.sessions[key], self.drives[key] = Session(wanted), 0
        return message("SessionRequestStatus")

    def submit_image_observation(self, request: Any) -> Any:
        session, image = self._session(request), request.camera_image
        name = image.logical_id
        if name not in session.sizes:
            raise Refused(grpc.StatusCode.UNKNOWN, f"Camera {name} not in desired cameras")
        require(image.frame_start_us < image.frame_end_us, "a frame without length")
        last = session.image_times.get(name, -1)
        require(image.frame_start_us >= last, f"Frame {image.frame_end_us} is not in time order")
        data = image.image_bytes
        require(data[:4] == b"\x89PNG" or data[:3] == b"\xff\xd8\xff", "neither PNG nor JPEG")
        pixels = cv2.imdecode(np.frombuffer(data, np.uint8), cv2.IMREAD_COLOR)
        require(pixels is not None, "a damaged image")
        require(pixels.shape[1::-1] == session.sizes[name], "an image of another size")
        session.images[name] = pixels[..., ::-1]
        session.image_times[name] = image.frame_end_us
        return message("Empty")

    def submit_egomotion_observation(self, request: Any) -> Any:
        session, poses = self._session(request), request.trajectory.poses
        require(len(poses) > 0, "no pose")
        require(len(poses) == len(request.dynamic_states), "states are not 1:1 with poses")
        for pose, state in zip(poses, request.dynamic_states, strict=True):
            here, velocity = read_pose(pose.pose, "pose"), state.linear_velocity
            if session.poses:
                before_us, before = session.poses[-1]
                passed = (pose.timestamp_us - before_us) * 1e-6
                require(passed > 0.0, "egomotion is not in time order")
                moved = before[:3, :3].T @ (here[:3, 3] - before[:3, 3]) / passed
                told = np.array([velocity.x, velocity.y])
                fits = np.linalg.norm(moved[:2] - (told + session.velocity) / 2) < _SPEED_TOLERANCE
                require(bool(fits), f"poses move by {moved}, told are {told}: wrong frame")
            session.poses.append((pose.timestamp_us, here))
            session.velocity = (velocity.x, velocity.y)
        return message("Empty")

    def submit_route(self, request: Any) -> Any:
        session, route = self._session(request), request.route
        points = np.array([[p.x, p.y, p.z] for p in route.waypoints])
        require(points.shape == (20, 3), f"a route of {len(points)} points")
        known = np.isfinite(points).all(axis=1)
        count = int(known.sum())
        require(bool(known[:count].all()), "NaN before a point")
        require(bool(np.isnan(points[count:]).all()), "a point that is half NaN")
        require(bool((points[:count, 2] == 0.0).all()), "a height in the route")
        apart = np.linalg.norm(np.diff(points[:count], axis=0), axis=1)
        require(bool(((apart >= 3.5) & (apart <= 4.5)).all()), "points not 3.5 to 4.5 m apart")
        if count > 1:  # it begins beside the ego
            along = (points[1] - points[0])[:2] / apart[0]
            require(abs(float(along @ points[0, :2])) < 1.0, "the route is of another frame")
        session.route, session.route_us = points, route.timestamp_us
        return message("Empty")

    def submit_recording_ground_truth(self, request: Any) -> Any:
        raise Refused(grpc.StatusCode.FAILED_PRECONDITION, "the answer is not to be told")

    def drive(self, request: Any) -> Any:
        session, now = self._session(request), request.time_now_us
        require(now > session.driven_us, "drives are not in time order")
        require(request.time_query_us > now, "the query is not later than now")
        require(bool(session.poses) and session.poses[-1][0] == now, "no egomotion for now")
        require(session.route is not None and session.route_us == now, "no route for now")
        for name in session.sizes:
            require(session.image_times.get(name) == now, f"no image of {name} for now")
        session.driven_us = now
        self.drives[request.session_uuid] += 1
        assert session.route is not None
        speed = float(np.hypot(*session.velocity))
        planned = self.rule(session.poses[-1][1], speed, session.route, session.images)
        poses = [
            message("PoseAtTime", pose=pose_message(pose), timestamp_us=now + index * STEP_US)
            for index, pose in enumerate(planned)
        ]
        return message("DriveResponse", trajectory=message("Trajectory", poses=poses))

    def close_session(self, request: Any) -> Any:
        self._session(request)
        del self.sessions[request.session_uuid]
        return message("Empty")

    def shut_down(self, request: Any) -> Any:
        raise Refused(grpc.StatusCode.PERMISSION_DENIED, "the driver is somebody else's")

    def _session(self, request: Any) -> Session:
        if request.session_uuid not in self.sessions:  # a KeyError of AlpaSim's driver
            text = f"Session {request.session_uuid} does not exist."
            raise Refused(grpc.StatusCode.UNKNOWN, text)
        return self.sessions[request.session_uuid]


def _handler(driver: FakeDriver, method: str) -> Callable[[bytes, Any], bytes]:
    def handle(data: bytes, context: Any) -> bytes:
        try:
            return driver.answer(method, data)
        except Refused as refused:
            context.abort(refused.code, refused.details)
        raise AssertionError

    return handle


@contextmanager
def driving(driver: FakeDriver, port: int = 0) -> Iterator[int]:
    """Serve the driver; the port."""
    pool = ThreadPoolExecutor(4)
    server = grpc.server(pool, options=[("grpc.so_reuseport", 0)])
    handlers = {
        method: grpc.unary_unary_rpc_method_handler(_handler(driver, method))
        for method in EGODRIVER_METHODS
    }
    generic = grpc.method_handlers_generic_handler("egodriver.EgodriverService", handlers)
    server.add_generic_rpc_handlers((generic,))
    found = server.add_insecure_port(f"127.0.0.1:{port}")
    server.start()
    try:
        yield found
    finally:
        server.stop(None).wait()
        pool.shutdown()


if __name__ == "__main__":
    with driving(FakeDriver(), int(sys.argv[1])) as here:
        print(here, flush=True)
        time.sleep(600)
