"""The page of the screening over HTTP, for browsers on this machine only."""

from __future__ import annotations

from collections.abc import Awaitable, Callable, Mapping
from functools import cache
from importlib.resources import files
from typing import Any

from starlette.applications import Starlette
from starlette.concurrency import run_in_threadpool
from starlette.exceptions import HTTPException
from starlette.middleware import Middleware
from starlette.middleware.base import BaseHTTPMiddleware, RequestResponseEndpoint
from starlette.requests import Request
from starlette.responses import HTMLResponse, JSONResponse, Response
from starlette.routing import Route

from recast.core.errors import InputError
from recast.core.web_server import BodyError, WebServer, json_body
from recast.recar.screening.service import RefusedDecisionError, ScreeningService

CONTENT_POLICY = (
    "default-src 'none'; img-src 'self' data:; connect-src 'self'; style-src 'unsafe-inline'; "
    "script-src 'unsafe-inline'; base-uri 'none'; form-action 'none'; frame-ancestors 'none'"
)
"""What the browser lets the page do: ask its own server, nothing else."""
HOST = "127.0.0.1"
_HEADERS = {
    "Cache-Control": "no-store",
    "Content-Security-Policy": CONTENT_POLICY,
    "X-Content-Type-Options": "nosniff",
}
_MOST_BODY = 10_000  # bytes
_Answer = Callable[[Mapping[str, Any]], dict[str, Any]]


@cache
def page() -> str:
    """HTML with style and script inside."""
    folder = files("recast.recar.screening") / "web"
    text = (folder / "page.html").read_text(encoding="utf-8")
    for name, mark in (("page.css", "/* STYLE */"), ("page.js", "/* SCRIPT */")):
        text = text.replace(mark, (folder / name).read_text(encoding="utf-8"))
    return text


def screening_app(service: ScreeningService) -> Starlette:
    """The page of one cache, its pictures, and its questions and decisions as JSON."""

    def picture(request: Request) -> Response:
        name, kind = request.path_params["name"], request.path_params["kind"]
        sheet = kind == "turntable"
        data = service.preview(name) if sheet else service.input_view(name, kind)
        return Response(data, media_type="image/png")

    def asked(answer: _Answer) -> Callable[[Request], Response]:
        return lambda request: JSONResponse(answer(request.query_params))

    def decided(answer: _Answer) -> Callable[[Request], Awaitable[Response]]:
        async def decide(request: Request) -> Response:
            return JSONResponse(await run_in_threadpool(answer, await _body(request)))

        return decide

    app = Starlette(
        routes=[
            Route("/", lambda _: HTMLResponse(page())),
            Route("/picture/{name:path}/{kind}", picture),
            Route("/api/state", asked(lambda _: service.state())),
            Route("/api/items", asked(service.items)),
            Route("/api/search", asked(service.search)),
            Route("/api/news", asked(service.news)),
            Route("/api/decide", decided(service.decide), methods=["POST"]),
            Route("/api/undo", decided(service.undo), methods=["POST"]),
        ],
        middleware=[Middleware(BaseHTTPMiddleware, dispatch=_add_headers)],
        exception_handlers={
            RefusedDecisionError: lambda _, refused: _refusal(refused),
            BodyError: lambda _, error: _refusal(RefusedDecisionError(error.status, str(error))),
            InputError: lambda _, error: JSONResponse({"error": str(error)}, 500),
            HTTPException: lambda _, error: _refusal(RefusedDecisionError(404, "no such page")),
        },
    )
    app.router.redirect_slashes = False
    return app


async def _add_headers(request: Request, answer: RequestResponseEndpoint) -> Response:
    if request.scope["path"].startswith("/"):
        response = await answer(request)
    else:
        response = _refusal(RefusedDecisionError(400, "address: is not a path"))
    response.headers.update(_HEADERS)
    return response


async def _body(request: Request) -> dict[str, Any]:
    body = await json_body(request, _MOST_BODY)
    if not isinstance(body, dict):
        raise BodyError(400, "body: is not a JSON object")
    return body


def _refusal(refused: RefusedDecisionError) -> Response:
    return JSONResponse(refused.answer, refused.status)


class ScreeningServer(WebServer):
    """Serves one cache on 127.0.0.1 until `should_exit` is set.

    Args:
        service: screening service of the cache.
        port: port number; 0 takes any that is free, see `url`.

    Raises:
        InputError: the port is taken, or may not be used.
    """

    def __init__(self, service: ScreeningService, port: int) -> None:
        super().__init__(screening_app(service), HOST, port)

    @property
    def url(self) -> str:
        """Address of the page."""
        return f"http://{HOST}:{self.port}/"
