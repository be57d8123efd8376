"""recast as NeuroNCAP's renderer: one scene over HTTP, with the actors where the engine puts them.

Whatever a client sends is answered with a status of its own; the server goes on. Requests are JSON,
so nothing is unpickled.
"""

from __future__ import annotations

import logging
from collections.abc import Awaitable, Callable, Mapping

from starlette.applications import Starlette
from starlette.concurrency import run_in_threadpool
from starlette.exceptions import HTTPException
from starlette.requests import Request
from starlette.responses import JSONResponse, Response
from starlette.routing import Route

from recast.core.errors import printable
from recast.core.web_server import BodyError, json_body
from recast_bridges.neuroncap.service import NcapService
from recast_bridges.requests import RefusedError

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
