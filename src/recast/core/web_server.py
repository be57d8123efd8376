"""A server of HTTP on an address of this machine: who may ask it, and requests within limits.

A browser lets every page that a person opens send requests to servers of that person's machine.
Such a page names itself (`Origin`), or has a name of its own that leads to 127.0.0.1 and then
counts as a page of this server (`Host`, "DNS rebinding"). `refusal_of` tells both from pages of
this server and from programs. All servers of recast ask it.
"""

from __future__ import annotations

import asyncio
import errno
import logging
import socket
from collections.abc import Collection, Iterator, Sequence
from contextlib import contextmanager
from ipaddress import ip_address
from threading import Thread
from typing import Any, Self
from urllib.parse import urlsplit

import uvicorn
from starlette.applications import Starlette
from starlette.datastructures import Headers
from starlette.requests import ClientDisconnect, Request
from starlette.responses import JSONResponse
from starlette.types import ASGIApp, Receive, Scope, Send
from uvicorn.protocols.http.h11_impl import H11Protocol

from recast.core.errors import InputError
from recast.core.files import parse_json

_LOG = logging.getLogger(__name__)

_BODY_SECONDS = 60.0
"""Within which the body of a request must be there."""
_HEADER_SECONDS = 10.0
"""Within which the headers of a request must be there, as in the server of WebSockets."""


def refusal_of(
    listening: str, hosts: Sequence[str], origins: Sequence[str], names: Collection[str] = ()
) -> str | None:
    """Why a request is not answered; None if it may ask.

    Ports are not compared with our own: behind a tunnel the browser knows another one. A page of
    another port has another `Host` in its `Origin`.

    Args:
        listening: address that the server listens on.
        hosts: values of the header `Host`.
        origins: values of the header `Origin`, which browsers send and programs do not.
        names: further names, in lower case, under which the server may be asked.
    """
    if len(hosts) != 1:
        return "Host: is missing, or given twice"
    host = hosts[0].lower()
    name = _name_of(host)
    if not _is_ours(name, listening, names):
        return f"Host: {hosts[0][:100]!r} is not a name of this server"
    own = [f"http://{host}"]
    if name in names:  # which a proxy may serve by TLS
        own.append(f"https://{host}")
    if any(origin.lower() not in own for origin in origins):
        return "Origin: only pages of this server may ask it"
    return None


def _name_of(host: str) -> str:
    """The name or address in a `Host`, without its port."""
    try:
        return (urlsplit(f"//{host}").hostname or "").rstrip(".")
    except ValueError:
        return ""


def _is_ours(name: str, listening: str, names: Collection[str]) -> bool:
    """Whether a server that listens on an address can be meant by a name or an address.

    No page can give itself an address for a name, so addresses are free once others may ask.
    """
    if name == "localhost" or name in names:
        return True
    address, ours = _address(name), _address(listening)
    if address is not None and address.is_loopback:
        return True
    if listening == "localhost" or (ours is not None and ours.is_loopback):
        return False
    own = (listening, socket.gethostname(), socket.getfqdn())
    return address is not None or name in (one.lower() for one in own)


def _address(name: str) -> Any:
    try:
        return ip_address(name)
    except ValueError:
        return None


class BodyError(Exception):
    """A body that is not taken.

    Attributes:
        status: HTTP status code.
    """

    def __init__(self, status: int, message: str) -> None:
        super().__init__(message)
        self.status = status


async def json_body(request: Request, most_bytes: int) -> Any:
    """The JSON value of a request's body.

    Raises:
        BodyError: another content type (415), longer than `most_bytes` (413), too slow or cut off
            (408), framed in two ways (400), or not JSON (400).
    """
    kind = request.headers.get("Content-Type", "").partition(";")[0].strip().lower()
    if kind != "application/json":
        raise BodyError(415, "body: is not application/json")
    if "Content-Length" in request.headers and "Transfer-Encoding" in request.headers:
        raise BodyError(400, "body: must have a length and no transfer encoding")
    data = bytearray()
    try:
        async with asyncio.timeout(_BODY_SECONDS):
            async for part in request.stream():
                data += part
                if len(data) > most_bytes:
                    raise BodyError(413, f"body: has more than {most_bytes} bytes")
    except (TimeoutError, ClientDisconnect):
        raise BodyError(408, f"body: did not come within {_BODY_SECONDS:g} s") from None
    try:
        return parse_json("body", bytes(data))
    except InputError as error:
        raise BodyError(400, f"body: {error.problem}") from None


class _Guarded:
    """An application that answers nobody else than `refusal_of` lets ask."""

    def __init__(self, app: ASGIApp, listening: str, names: Collection[str]) -> None:
        self._app, self._listening, self._names = app, listening, names

    async def __call__(self, scope: Scope, receive: Receive, send: Send) -> None:
        answer = self._app
        if scope["type"] != "lifespan":
            headers = Headers(scope=scope)
            hosts, origins = headers.getlist("host"), headers.getlist("origin")
            refused = refusal_of(self._listening, hosts, origins, self._names)
            if refused is not None:
                answer = JSONResponse({"error": refused, "detail": refused}, 403)
        try:
            await answer(scope, receive, send)
        except Exception:
            _LOG.exception("%s failed", scope.get("path"))
            raise


class _Protocol(H11Protocol):
    """HTTP/1.1 whose headers come within `_HEADER_SECONDS`; uvicorn would wait for ever."""

    _late: asyncio.TimerHandle | None = None

    def connection_made(self, transport: asyncio.Transport) -> None:  # type: ignore[override]
        super().connection_made(transport)
        self._expect()

    def data_received(self, data: bytes) -> None:
        waiting = self.cycle is None or self.cycle.response_complete
        super().data_received(data)
        asked = self.cycle is not None and not self.cycle.response_complete
        if asked and self._late is not None:
            self._late.cancel()
            self._late = None
        elif waiting and not asked and self._late is None:
            self._expect()

    def connection_lost(self, exc: Exception | None) -> None:
        if self._late is not None:
            self._late.cancel()
        super().connection_lost(exc)

    def _expect(self) -> None:
        self._late = self.loop.call_later(_HEADER_SECONDS, self.transport.close)


class WebServer(uvicorn.Server):
    """Serves an application; a context manager, at whose end nobody listens any more.

    Args:
        host: address to listen on. The channel is not secured: every program that reaches it may
            ask, and no page of another site, see `refusal_of`.
        port: port to listen on; 0 takes any that is free, see `port`.
        names: further names of this machine that requests may use, such as that of a container,
            in lower case.

    Raises:
        InputError: the port is taken, or may not be used; or the address is not one of this
            machine.
    """

    def __init__(self, app: Starlette, host: str, port: int, names: Collection[str] = ()) -> None:
        family = socket.AF_INET6 if ":" in host else socket.AF_INET
        try:
            self.socket = socket.create_server((host, port), family=family)
        except (OSError, OverflowError) as error:
            taken = getattr(error, "errno", None) == errno.EADDRINUSE
            problem = "is taken by another program" if taken else f"cannot be used ({error})"
            raise InputError(
                "`port`", str(port), problem, "choose another port, or 0 for a free one"
            ) from None
        super().__init__(
            uvicorn.Config(
                _Guarded(app, host, names),
                http=_Protocol,
                # The server's own records; those of recast go where `diagnostics` says.
                log_config=None,
                log_level=60,
                server_header=False,
                timeout_graceful_shutdown=1,
            )
        )

    @property
    def port(self) -> int:
        """Where it listens."""
        port: int = self.socket.getsockname()[1]
        return port

    def serve_forever(self) -> None:
        """Answer until `should_exit` is set, or Ctrl-C, which is raised again."""
        self.run([self.socket])

    @contextmanager
    def in_background(self) -> Iterator[Self]:
        """Answer in a thread of its own until the block ends; then nobody listens any more."""
        thread = Thread(target=self.serve_forever, name=f"http-{self.port}", daemon=True)
        with self:
            thread.start()
            try:
                yield self
            finally:
                self.should_exit = True
                thread.join()

    def __enter__(self) -> Self:
        return self

    def __exit__(self, *error: object) -> None:
        self.socket.close()
