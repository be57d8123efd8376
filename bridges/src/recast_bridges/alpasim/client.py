"""Calls of another program's service over gRPC: deadline, retries, and one line for each fault."""

from __future__ import annotations

import time
from collections.abc import Mapping, Sequence
from typing import Any, Literal

import grpc
import numpy as np
from google.protobuf.message import DecodeError

from recast.arrays import Array, Image
from recast.cameras import CameraMount, PinholeCamera
from recast.core.errors import InputError
from recast.core.workers import Closing
from recast.geometry import se3
from recast.logs.images import decode
from recast.simulation.renderer import MountedRenderer
from recast.simulation.rollout import SimState
from recast_bridges.alpasim.messages import (
    CHANNEL_OPTIONS,
    DEADLINE,
    JPEG,
    JPEG_QUALITY,
    PAUSES,
    PLANAR,
    PNG,
    SENSORSIM_METHODS,
    SENSORSIM_SERVICES,
    Methods,
    camera_message,
    message,
    parse,
    pose_pair,
)

_RECONNECT = (
    # Milliseconds: a server that comes back is found within the pauses.
    ("grpc.initial_reconnect_backoff_ms", 200),
    ("grpc.min_reconnect_backoff_ms", 200),
    ("grpc.max_reconnect_backoff_ms", 1000),
)
_MEND = "see the server's log"


class ServiceClient(Closing):
    """Calls of a service; a context manager.

    Args:
        address: host:port. The channel is not secured.
        methods: request and reply of each method; `get_version` must be among them.
        paths: names of the service, tried in turn; the first one that the server knows is kept.
        deadline: seconds that a call may take.
        pauses: seconds before each further try where the server is not there (UNAVAILABLE).
        mends: what the user can do, by the name of a status code; "see the server's log" for
            others.

    Attributes:
        version: what the server calls itself, its version_id.
        full_version: the same with commit and version of the messages, as far as it says them.

    Raises:
        InputError: no such server, or it knows none of the names.
    """

    def __init__(
        self,
        address: str,
        methods: Methods,
        paths: Sequence[str],
        *,
        deadline: float = DEADLINE,
        pauses: Sequence[float] = PAUSES,
        mends: Mapping[str, str] | None = None,
    ) -> None:
        self.address, self._methods, self._mends = address, methods, mends or {}
        self._deadline, self._pauses = deadline, tuple(pauses)
        self._channel = grpc.insecure_channel(address, options=CHANNEL_OPTIONS + _RECONNECT)
        try:
            self._path, found = self._connect(paths)
        except BaseException:
            self.close()
            raise
        self.version: str = found.version_id
        self.full_version = _version_text(found)

    def _connect(self, paths: Sequence[str]) -> tuple[str, Any]:
        refused: grpc.RpcError | None = None
        for path in paths:
            try:
                return path, self._tried(path, "get_version", message("Empty"), self._deadline)
            except grpc.RpcError as error:
                if error.code() is not grpc.StatusCode.UNIMPLEMENTED:
                    raise self._failure("get_version", error) from None
                refused = error
        assert refused is not None, "no paths"
        raise self._failure("get_version", refused)

    def call(self, method: str, request: Any, deadline: float | None = None) -> Any:
        """The reply of one of the methods.

        Args:
            deadline: seconds that the call may take; None for the client's.

        Raises:
            InputError: the call failed: with the status and the text of the server.
        """
        try:
            return self._tried(self._path, method, request, deadline or self._deadline)
        except grpc.RpcError as error:
            raise self._failure(method, error) from None

    def close(self) -> None:
        """Close the channel; a call that another thread waits for ends as cancelled."""
        self._channel.close()

    def _tried(self, path: str, method: str, request: Any, deadline: float) -> Any:
        data, reply = request.SerializeToString(), self._methods[method][1]
        ask = self._channel.unary_unary(f"/{path}/{method}")
        for pause in (*self._pauses, None):
            try:
                return parse(reply, ask(data, timeout=deadline))
            except DecodeError:
                problem = f"answered with data that is not a {reply}"
                raise InputError(self.address, method, problem, _MEND) from None
            except grpc.RpcError as error:
                if error.code() is not grpc.StatusCode.UNAVAILABLE or pause is None:
                    raise
            time.sleep(pause)
        raise AssertionError  # the last try raises

    def _failure(self, method: str, error: grpc.RpcError) -> InputError:
        code = error.code().name
        mend = self._mends.get(code, _MEND)
        return InputError(self.address, method, f"{code}: {error.details()}", mend)


def _version_text(found: Any) -> str:
    """A message VersionId in words; what it leaves empty is left out."""
    api = found.grpc_api_version
    commit = f"git {found.git_hash}" if found.git_hash else ""
    number = f"{api.major}.{api.minor}.{api.patch}"
    messages = f"API {number}" if found.HasField("grpc_api_version") else ""
    return ", ".join(filter(None, (found.version_id or "unnamed", commit, messages)))


_FORMATS = {"png": PNG, "jpeg": JPEG, "planar": PLANAR}
_ANY_SCENE = "*"


class SensorsimClient(ServiceClient):
    """Calls of a SensorsimService; a context manager.

    Args:
        address: host:port. The channel is not secured.
        deadline: seconds that a call may take.
        pauses: seconds before each further try where the server is not there (UNAVAILABLE).
        paths: names of the service, tried in turn; the first one that the server knows is kept.

    Raises:
        InputError: no such server, or it knows none of the names.
    """

    def __init__(
        self,
        address: str,
        *,
        deadline: float = DEADLINE,
        pauses: Sequence[float] = PAUSES,
        paths: Sequence[str] = SENSORSIM_SERVICES,
    ) -> None:
        super().__init__(address, SENSORSIM_METHODS, paths, deadline=deadline, pauses=pauses)

    def scenes(self) -> tuple[str, ...]:
        """Ids of the server's scenes; "*" stands for any."""
        return tuple(self.call("get_available_scenes", message("Empty")).scene_ids)

    def require_scene(self, scene_id: str) -> None:
        """Check that the server has a scene. Raises InputError: it has not."""
        known = self.scenes()
        if scene_id not in known and _ANY_SCENE not in known:
            mend = f"choose one of {', '.join(known) or 'none'}"
            raise InputError(self.address, f"scene {scene_id}", "is not served", mend)

    def cameras(self, scene_id: str) -> tuple[Any, ...]:
        """The messages AvailableCamera of a scene; see `recast_bridges.alpasim.messages`."""
        request = message("AvailableCamerasRequest", scene_id=scene_id)
        return tuple(self.call("get_available_cameras", request).available_cameras)


class SensorsimRenderer(MountedRenderer, Closing):
    """Renders a scene of a SensorsimService; a `SensorRenderer` and a context manager.

    All cameras of a step are asked for in one call of `batch_render_rgb`, with the same pose at the
    start and the end of the frame. Cameras with distortion are rendered by the server, so that only
    virtual ones need `through_lenses`. Poses are rounded to float32 on the way.

    Args:
        client: client of the server; the renderer does not close it.
        scene_id: one of `SensorsimClient.scenes`.
        mounts: cameras to render, see `camera_mounts`; those of the server's list need not be used.
        image_format: "png" and "planar" keep every pixel as it was drawn, "jpeg" does not.
        world_from_local: (4, 4) rigid; the server's local frame in the log's world.

    Raises:
        InputError: the server has no such scene, or does not answer.
    """

    def __init__(
        self,
        client: SensorsimClient,
        scene_id: str,
        mounts: Mapping[str, CameraMount],
        *,
        image_format: Literal["png", "jpeg", "planar"] = "png",
        world_from_local: Array | None = None,
    ) -> None:
        super().__init__(mounts)
        client.require_scene(scene_id)
        self._client, self._scene_id, self._format = client, scene_id, image_format
        world = np.eye(4) if world_from_local is None else world_from_local
        self._local_from_world = se3.inverse(world)

    def render(self, state: SimState, camera_names: Sequence[str]) -> dict[str, Image]:
        """Images of the named cameras at `state`. Raises InputError: the call failed, or the reply
        lacks an image or holds a damaged one."""
        names = list(dict.fromkeys(camera_names))
        items = [
            message("BatchItem", camera_name=name, request=self._request(state, name))
            for name in names
        ]
        reply = self._client.call("batch_render_rgb", message("BatchRGBRenderRequest", items=items))
        for item in reply.items:
            if not item.success:
                raise self._fault(item.camera_name, f"failed: {item.error_message}")
        found = {item.camera_name: item.result.image_bytes for item in reply.items}
        if len(reply.items) != len(names) or set(found) != set(names):
            shown = ", ".join(item.camera_name for item in reply.items) or "nothing"
            raise self._fault(", ".join(names), f"were requested, but the reply has {shown}")
        return {name: self._image(name, found[name]) for name in names}

    def _request(self, state: SimState, name: str) -> Any:
        camera = self._mounts[name].camera
        local_from_rig = self._local_from_world @ state.world_from_rig
        local_from_camera = local_from_rig @ self._mounts[name].rig_from_camera
        actors = [
            message(
                "DynamicObject", track_id=key, pose_pair=pose_pair(self._local_from_world @ pose)
            )
            for key, pose in state.poses.items()
        ]
        rig = pose_pair(local_from_rig)
        return message(
            "RGBRenderRequest",
            scene_id=self._scene_id,
            resolution_h=camera.height,
            resolution_w=camera.width,
            camera_intrinsics=camera_message(camera, name),
            frame_start_us=state.timestamp_us,
            frame_end_us=state.timestamp_us + 1,
            sensor_pose=pose_pair(local_from_camera),
            dynamic_objects=actors,
            image_format=_FORMATS[self._format],
            image_quality=JPEG_QUALITY,
            ego_pose=rig,
            challenge_ego_pose=rig,
        )

    def _image(self, name: str, data: bytes) -> Image:
        camera: PinholeCamera = self._mounts[name].camera
        size = camera.width, camera.height
        if self._format != "planar":
            return decode(
                data, self._format, size, f"{self._client.address}, {name}", "the request"
            )
        if len(data) != 3 * camera.width * camera.height:
            problem = f"has {len(data)} bytes, but {size[0]}x{size[1]} pixels were requested"
            raise self._fault(name, problem)
        planes = np.frombuffer(data, np.uint8).reshape(3, camera.height, camera.width)
        return np.ascontiguousarray(np.moveaxis(planes, 0, -1))

    def _fault(self, what: str, problem: str) -> InputError:
        return InputError(self._client.address, what, problem, "see the server's log")
