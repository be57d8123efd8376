"""A recast scene as the renderer of NeuroNCAP's engine: its service, images and cameras."""

from __future__ import annotations

import base64
import io
import logging
from collections.abc import Awaitable, Callable, Mapping
from dataclasses import dataclass
from typing import Any

import numpy as np
import torch
from starlette.applications import Starlette
from starlette.concurrency import run_in_threadpool
from starlette.exceptions import HTTPException
from starlette.requests import Request
from starlette.responses import JSONResponse, Response
from starlette.routing import Route

from recast.arrays import Array, Image
from recast.cameras import CameraMount
from recast.cameras.mounts import Look, match_cameras
from recast.core.errors import printable
from recast.core.web_server import BodyError, json_body
from recast.geometry import se3
from recast.logs import images
from recast.logs.checks import BOX_SIDE, LATEST_US, WORLD_REACH, are_box_sides, check_poses
from recast.logs.types import Trajectory
from recast_bridges.rendering import ScenePainter
from recast_bridges.requests import RefusedError, RenderRequest

CAMERAS: Mapping[str, Look] = {
    "CAM_FRONT": Look.level(0.0, 65.0),
    "CAM_FRONT_LEFT": Look.level(55.0, 65.0),
    "CAM_FRONT_RIGHT": Look.level(-55.0, 65.0),
    "CAM_BACK": Look.level(180.0, 90.0),
    "CAM_BACK_LEFT": Look.level(110.0, 65.0),
    "CAM_BACK_RIGHT": Look.level(-110.0, 65.0),
}
"""The six cameras of nuScenes in NeuroNCAP's order, and where they look, rounded."""
MEDIA_TYPES = {"raw": "text/plain", "png": "image/png", "jpg": "text/jpeg", "jpeg": "text/jpeg"}
"""Media types of the image formats, by name; text/jpeg is what NeuroNCAP's own renderer says."""


def raw_image(image: Image) -> str:
    """An image (height, width, 3) uint8 RGB as base64 of what `torch.save` writes of it.

    The other side reads it with `torch.load`, which unpickles. Nothing here ever does.
    """
    stream = io.BytesIO()
    torch.save(torch.from_numpy(image.copy()), stream)
    return base64.b64encode(stream.getvalue()).decode("ascii")


def encode(image: Image, image_format: str) -> bytes:
    """An image (height, width, 3) uint8 RGB in a format of `MEDIA_TYPES`."""
    if image_format == "raw":
        return raw_image(image).encode("ascii")
    return images.encode(image, "png" if image_format == "png" else "jpeg")


def ncap_cameras(mounts: Mapping[str, CameraMount]) -> dict[str, str]:
    """NeuroNCAP's name to the rig's camera that stands for it: of the same name, or by direction.

    Cameras that no camera of the rig stands for are left out, and so are cameras with distortion,
    which the messages cannot say.
    """
    straight = {name: mount for name, mount in mounts.items() if mount.camera.is_rectified}
    found = {name: name for name in CAMERAS if name in straight}
    wanted = {name: look for name, look in CAMERAS.items() if name not in found}
    found |= match_cameras(wanted, {k: m for k, m in straight.items() if k not in found})
    return {name: found[name] for name in CAMERAS if name in found}


# What recast answers as NeuroNCAP's renderer of one scene, free of HTTP.
#
# A service keeps one thing between requests: the actors that were last put.

_PREFIX = "CAM_"


@dataclass(frozen=True)
class NcapActor:
    """An actor of the messages."""

    trajectory: Trajectory  # `local_from_actor` of the box centre
    # width, length, height in metres. The drawn vehicle keeps its own size.
    dims: tuple[float, float, float]

    def to_json(self, uuid: str) -> dict[str, Any]:
        """The message."""
        return {
            "uuid": uuid,
            "poses": self.trajectory.poses.tolist(),
            "timestamps": self.trajectory.timestamps_us.tolist(),
            "dims": list(self.dims),
        }


class NcapService:
    """What the endpoints of one scene answer.

    Args:
        painter: painter that draws the images; it may have other scenes, too.
        scene_id: id of the scene.
    """

    def __init__(self, painter: ScenePainter, scene_id: str) -> None:
        self._painter, self._scene_id = painter, scene_id
        served = painter.scene(scene_id)
        local_from_world = se3.inverse(served.world_from_local)
        self._own = {
            key: NcapActor(
                Trajectory(
                    actor.trajectory.timestamps_us, local_from_world @ actor.trajectory.poses
                ),
                (float(actor.size[1]), float(actor.size[0]), float(actor.size[2])),
            )
            for key, actor in served.scene.actors.items()
        }
        self._actors = self._own
        self._cameras = {key.removeprefix(_PREFIX).lower(): key for key in served.cameras}

    def start_time(self) -> int:
        """Microseconds of the log's first ego pose."""
        return self._painter.scene(self._scene_id).start_us

    def actors(self) -> list[dict[str, Any]]:
        """The actors as they were last put; at first all that the scene has, as logged."""
        return [actor.to_json(uuid) for uuid, actor in self._actors.items()]

    def update(self, value: object) -> None:
        """Replace the actors by those of a list; who is not in it is not drawn any more. Raises
        RefusedError: INVALID_ARGUMENT names the member at fault; nothing has changed then."""
        found: dict[str, NcapActor] = {}
        for number, one in enumerate(_listed(value, "actors")):
            where = f"actors[{number}]"
            uuid = _member(one, "uuid", where)
            if not isinstance(uuid, str) or uuid not in self._own:
                raise _refused(f"{where}.uuid", f"{str(uuid)[:80]!r} is not an actor of the scene")
            if uuid in found:
                raise _refused(f"{where}.uuid", f"{uuid!r} is given twice")
            found[uuid] = _read_actor(one, where)
        self._actors = found

    def image(self, value: object) -> tuple[bytes, str]:
        """An image and its media type. Raises RefusedError: INVALID_ARGUMENT names the member at
        fault."""
        pose = _matrices(_member(value, "pose", "request"), "pose", ())
        time = _microseconds(_member(value, "timestamp", "request"), "timestamp")
        name = _member(value, "camera_name", "request")
        wanted = value.get("image_format", "raw") if isinstance(value, dict) else None
        if not isinstance(wanted, str) or wanted not in MEDIA_TYPES:
            known = ", ".join(MEDIA_TYPES)
            raise _refused("image_format", f"{str(wanted)[:80]!r} is not one of {known}")
        present = {
            uuid: actor.trajectory.at(time)
            for uuid, actor in self._actors.items()
            if actor.trajectory.covers(time)
        }
        camera = self._painter.scene(self._scene_id).cameras[self._camera(name)].camera
        request = RenderRequest(self._scene_id, camera, pose, time, present)
        return encode(self._painter.draw(request), wanted), MEDIA_TYPES[wanted]

    def _camera(self, name: object) -> str:
        """The log's camera of a name, with or without CAM_, in small letters or large."""
        cameras = self._painter.scene(self._scene_id).cameras
        if isinstance(name, str):
            if name in cameras:
                return name
            plain = name.removeprefix(_PREFIX).lower()
            if plain in self._cameras:
                return self._cameras[plain]
        raise _refused("camera_name", f"{str(name)[:80]!r} is not one of {', '.join(cameras)}")


def _refused(field: str, problem: str) -> RefusedError:
    return RefusedError("INVALID_ARGUMENT", f"{field}: {problem}")


def _listed(value: object, where: str) -> list[Any]:
    if not isinstance(value, list):
        raise _refused(where, "is not a list")
    return value


def _member(value: object, key: str, where: str) -> Any:
    if not isinstance(value, dict):
        raise _refused(where, "is not a JSON object")
    if key not in value:
        raise _refused(f"{where}.{key}" if where != "request" else key, "is missing")
    return value[key]


def _numbers(value: object, where: str, shape: tuple[int, ...]) -> Array:
    """Finite numbers of a shape; its first length is free where it is 0."""
    try:
        array = np.asarray(value)
    except ValueError:  # lists of different lengths
        array = np.asarray(None)
    wanted = "x".join(str(n) if n else "N" for n in shape)
    fits = array.ndim == len(shape) and array.dtype.kind in "if"
    if not fits or any(n not in (0, m) for n, m in zip(shape, array.shape, strict=True)):
        raise _refused(where, f"is not an array of {wanted} numbers")
    return array.astype(np.float64)


def _matrices(value: object, where: str, count: tuple[int, ...]) -> Array:
    poses = _numbers(value, where, (*count, 4, 4))
    try:
        check_poses(where, poses, WORLD_REACH)
    except ValueError as error:
        raise RefusedError("INVALID_ARGUMENT", str(error)) from None
    return poses


def _microseconds(value: object, where: str) -> int:
    if type(value) is not int or not 0 <= value < LATEST_US:
        raise _refused(where, f"{str(value)[:40]} is not a time in microseconds since 1970")
    return value


def _read_actor(one: object, where: str) -> NcapActor:
    poses = _matrices(_member(one, "poses", where), f"{where}.poses", (0,))
    listed = _listed(_member(one, "timestamps", where), f"{where}.timestamps")
    times = [_microseconds(time, f"{where}.timestamps") for time in listed]
    dims = _numbers(_member(one, "dims", where), f"{where}.dims", (3,))
    if not np.all(are_box_sides(dims)):
        low, high = BOX_SIDE
        raise _refused(f"{where}.dims", f"are not three lengths of {low:g} to {high:g} m")
    trajectory = Trajectory(np.array(times, np.int64), poses)
    try:
        trajectory.validate(where)
    except ValueError as error:
        raise RefusedError("INVALID_ARGUMENT", str(error)) from None
    width, length, height = dims.tolist()
    return NcapActor(trajectory, (width, length, height))


# recast as NeuroNCAP's renderer: one scene over HTTP, with the actors where the engine puts them.
#
# Whatever a client sends is answered with a status of its own; the server goes on. Requests are
# JSON, so nothing is unpickled.

_LOG = logging.getLogger(__name__)

MOST_BODY = 1 << 26
"""Bytes of a request's body, at most."""
_SHOWN = 300
_STATUS = {"NOT_FOUND": 404, "INVALID_ARGUMENT": 400, "UNIMPLEMENTED": 501}


def ncap_app(service: NcapService) -> Starlette:
    """The endpoints of one scene. An error is `{"detail": TEXT}`, one line."""

    def image(value: object) -> Response:
        data, media_type = service.image(value)
        return Response(data, media_type=media_type)

    def update(value: object) -> Response:
        service.update(value)
        return JSONResponse(None)

    def scale(value: object) -> Response:
        raise RefusedError(
            "UNIMPLEMENTED", "actor scale: is not supported, vehicles keep their size"
        )

    gets: Mapping[str, Callable[[], object]] = {
        "/alive": lambda: True,
        "/start_time": service.start_time,
        "/get_actors": service.actors,
    }
    posts: Mapping[str, Callable[[object], Response]] = {
        "/render_image": image,
        "/update_actors": update,
        "/set_actor_scale": scale,
    }
    return Starlette(
        routes=[
            *(Route(path, _got(answer), methods=["GET"]) for path, answer in gets.items()),
            *(Route(path, _posted(answer), methods=["POST"]) for path, answer in posts.items()),
        ],
        exception_handlers={HTTPException: _refuse_http},
    )


def _got(answer: Callable[[], object]) -> Callable[[Request], Awaitable[Response]]:
    async def handle(request: Request) -> Response:
        return await _answered(request, lambda: JSONResponse(answer()))

    return handle


def _posted(answer: Callable[[object], Response]) -> Callable[[Request], Awaitable[Response]]:
    async def handle(request: Request) -> Response:
        try:
            value = await json_body(request, MOST_BODY)
        except BodyError as error:
            return _refusal(error.status, str(error))
        return await _answered(request, lambda: answer(value))

    return handle


async def _answered(request: Request, answer: Callable[[], Response]) -> Response:
    path = request.url.path
    try:
        return await run_in_threadpool(answer)
    except RefusedError as refused:
        return _refusal(_STATUS[refused.code], refused.details)
    except Exception:
        _LOG.exception("%s failed", path)
        return _refusal(500, f"{path} failed; the server's log says why")


async def _refuse_http(request: Request, error: Exception) -> Response:
    assert isinstance(error, HTTPException)
    return _refusal(error.status_code, f"{request.method} {request.url.path}: {error.detail}")


def _refusal(status: int, problem: str) -> Response:
    return JSONResponse({"detail": printable(problem)[:_SHOWN]}, status)
