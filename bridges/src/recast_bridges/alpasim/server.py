"""The service SensorsimService over scenes: recast as the renderer of AlpaSim and of others.

It keeps no state between calls. Whatever a client sends or does is answered with a status of its
own call; the server goes on.
"""

from __future__ import annotations

import logging
from collections.abc import Callable, Sequence
from concurrent.futures import ThreadPoolExecutor
from typing import Any

import grpc
from google.protobuf.message import DecodeError

from recast import __version__
from recast.core.errors import InputError
from recast.core.workers import Closing
from recast_bridges.alpasim.messages import (
    CHANNEL_OPTIONS,
    FTHETA_CENTRE,
    MOST_BYTES,
    SENSORSIM_METHODS,
    SENSORSIM_SERVICES,
    cameras_message,
    encode,
    message,
    parse,
    read_requests,
)
from recast_bridges.rendering import ScenePainter
from recast_bridges.requests import RefusedError

_LOG = logging.getLogger(__name__)

VERSION_ID = f"recast-{__version__}-mid-frame-pose"
"""Says too that the shutter does not roll: images show the pose at mid-frame."""
API_VERSION = (0, 54, 0)
"""Version of AlpaSim's messages that these are."""
HOST, PORT = "127.0.0.1", 50051
WORKERS = 8
"""Threads that answer calls. One draws at a time, the others read, encode and send."""
QUEUE = 256
"""Calls that wait, at most, beside those that are answered."""

_NO_LIDAR = "recast does not render LiDAR"
UNANSWERED = {
    "render_lidar": _NO_LIDAR,
    "get_loaded_scenes": "recast loads a scene when it is rendered; call get_available_scenes",
    "get_available_trajectories": "recast does not serve trajectories; the scene's bundle has them",
}
"""Methods of the service that are answered with UNIMPLEMENTED, and what is said of them."""

_Call = Callable[[], bool]


class SensorsimService:
    """The methods of the service, each from message to message; free of gRPC.

    Args:
        painter: painter that draws the images.
        ftheta_centre: see `recast_bridges.alpasim.messages.FTHETA_CENTRE`.
    """

    def __init__(self, painter: ScenePainter, ftheta_centre: float = FTHETA_CENTRE) -> None:
        self._painter, self._ftheta_centre = painter, ftheta_centre

    def answer(self, method: str, data: bytes, wanted: _Call = lambda: True) -> bytes:
        """The reply to a request, both encoded.

        Args:
            wanted: whether the caller still waits.

        Raises:
            RefusedError: the call fails with its status.
        """
        if method in UNANSWERED:
            raise RefusedError("UNIMPLEMENTED", f"{method}: {UNANSWERED[method]}")
        request, reply = SENSORSIM_METHODS[method]
        try:
            asked = parse(request, data)
        except DecodeError:
            raise RefusedError(
                "INVALID_ARGUMENT", f"the request cannot be read as {request}"
            ) from None
        found: bytes = getattr(self, f"_{method}")(asked, wanted).SerializeToString()
        if len(found) > MOST_BYTES:
            raise RefusedError(
                "RESOURCE_EXHAUSTED", f"the {reply} has {len(found)} bytes, more than {MOST_BYTES}"
            )
        return found

    def _get_version(self, asked: Any, wanted: _Call) -> Any:
        major, minor, patch = API_VERSION
        api = message("ApiVersion", major=major, minor=minor, patch=patch)
        return message("VersionId", version_id=VERSION_ID, grpc_api_version=api)

    def _get_available_scenes(self, asked: Any, wanted: _Call) -> Any:
        return message("AvailableScenesReturn", scene_ids=list(self._painter.scenes))

    def _get_available_cameras(self, asked: Any, wanted: _Call) -> Any:
        return cameras_message(self._painter.scene(asked.scene_id).cameras)

    def _get_available_ego_masks(self, asked: Any, wanted: _Call) -> Any:
        return message("AvailableEgoMasksReturn")

    def _render_rgb(self, asked: Any, wanted: _Call) -> Any:
        return message("RGBRenderReturn", image_bytes=self._images([asked], wanted)[0])

    def _batch_render_rgb(self, asked: Any, wanted: _Call) -> Any:
        names = [item.camera_name for item in asked.items]
        if len(set(names)) < len(names):
            raise RefusedError("INVALID_ARGUMENT", "items: a camera_name appears twice")
        images = self._images([item.request for item in asked.items], wanted)
        items = [
            message(
                "BatchResult",
                camera_name=name,
                result=message("RGBRenderReturn", image_bytes=image),
                success=True,
            )
            for name, image in zip(names, images, strict=True)
        ]
        return message("BatchRGBRenderReturn", items=items)

    def _render_aggregated(self, asked: Any, wanted: _Call) -> Any:
        if asked.lidar_requests:
            raise RefusedError("UNIMPLEMENTED", f"lidar_requests: {_NO_LIDAR}")
        images = self._images(asked.rgb_requests, wanted)
        returns = [message("RGBRenderReturn", image_bytes=image) for image in images]
        return message("AggregatedRenderReturn", rgb_returns=returns)

    def _images(self, requests: Sequence[Any], wanted: _Call) -> list[bytes]:
        """The encoded images, in order. All are checked before the first is drawn."""
        for request in requests:
            self._painter.scene(request.scene_id)
        found: list[bytes] = []
        left = MOST_BYTES
        for view in read_requests(requests, self._ftheta_centre):
            image = self._painter.draw(view, wanted)
            found.append(encode(image, view.image_format, view.quality))
            left -= len(found[-1])
            if left < 0:
                raise RefusedError(
                    "RESOURCE_EXHAUSTED", f"the images have more than {MOST_BYTES} bytes"
                )
        return found


class SensorsimServer(Closing):
    """Serves scenes until it is closed; a context manager.

    Args:
        service: service that answers the calls.
        host: address to listen on. The channel is not secured: everybody who reaches it may ask.
        port: port to listen on; 0 for any free one.
        workers: threads, see `WORKERS`.
        queue: see `QUEUE`; further calls are answered with RESOURCE_EXHAUSTED.
        paths: names under which the service is found.

    Attributes:
        port: port on which it listens.

    Raises:
        InputError: the port is taken, or the address is none of this machine.
    """

    def __init__(
        self,
        service: SensorsimService,
        host: str = HOST,
        port: int = PORT,
        *,
        workers: int = WORKERS,
        queue: int = QUEUE,
        paths: Sequence[str] = SENSORSIM_SERVICES,
    ) -> None:
        self._pool = ThreadPoolExecutor(workers, "sensorsim")
        self._server = grpc.server(
            self._pool,
            # Two servers at one port would each get a share of the calls.
            options=[*CHANNEL_OPTIONS, ("grpc.so_reuseport", 0)],
            maximum_concurrent_rpcs=workers + queue,
        )
        # Messages are decoded in the handlers, where what is none gets its status.
        handlers = {
            method: grpc.unary_unary_rpc_method_handler(_handler(service, method))
            for method in (*SENSORSIM_METHODS, *UNANSWERED)
        }
        for path in paths:
            generic = grpc.method_handlers_generic_handler(path, handlers)
            self._server.add_generic_rpc_handlers((generic,))
        place = f"{host}:{port}"
        try:
            self.port = self._server.add_insecure_port(place)
        except RuntimeError:
            self.port = 0
        if not self.port:
            mend = "choose a free port and an address of this machine"
            raise InputError(
                "`port`", place, "is in use or is not an address of this machine", mend
            )
        self._server.start()

    def wait(self) -> None:
        """Wait until it is closed."""
        self._server.wait_for_termination()

    def close(self, grace: float | None = None) -> None:
        """End it.

        Args:
            grace: seconds that calls may still take; None cancels them.
        """
        self._server.stop(grace).wait()
        self._pool.shutdown(wait=True)


def _handler(service: SensorsimService, method: str) -> Callable[[bytes, Any], bytes]:
    def handle(data: bytes, context: Any) -> bytes:
        try:
            return service.answer(method, data, context.is_active)
        except RefusedError as refused:
            code, details = refused.code, refused.details
        except Exception:
            _LOG.exception("%s failed", method)
            code, details = "INTERNAL", f"{method} failed; the server's log says why"
        context.abort(getattr(grpc.StatusCode, code), details)
        raise AssertionError  # abort raises

    return handle
