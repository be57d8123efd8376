"""A server of HTTP on an address of this machine, and the body of a request within limits."""

from __future__ import annotations

import asyncio
import errno
import socket
from collections.abc import Iterator
from contextlib import contextmanager
from threading import Thread
from typing import Any, Self

import uvicorn
from starlette.applications import Starlette
from starlette.requests import ClientDisconnect, Request

from recast.core.errors import InputError
from recast.core.files import parse_json

_BODY_SECONDS = 60.0
"""Within which the body of a request must be there."""


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
            (408), or no JSON (400).
    """
    kind = request.headers.get("Content-Type", "").partition(";")[0].strip().lower()
    if kind != "application/json":
        raise BodyError(415, "body: is no application/json")
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


class WebServer(uvicorn.Server):
    """Serves an application; a context manager, at whose end nobody listens any more.

    Args:
        host: address to listen on. The channel is not secured: everybody who reaches it may ask.
        port: port to listen on; 0 takes any that is free, see `port`.

    Raises:
        InputError: the port is taken, or may not be used; or the address is none of this machine.
    """

    def __init__(self, app: Starlette, host: str, port: int) -> None:
        family = socket.AF_INET6 if ":" in host else socket.AF_INET
        try:
            self.socket = socket.create_server((host, port), family=family)
        except (OSError, OverflowError) as error:
            taken = getattr(error, "errno", None) == errno.EADDRINUSE
            problem = "is taken by another program" if taken else f"cannot be used ({error})"
            raise InputError("`port`", str(port), problem, "name another, or 0 for any") from None
        # Nothing is logged: the terminal is free for people.
        super().__init__(
            uvicorn.Config(
                app, log_config=None, log_level=60, server_header=False, timeout_graceful_shutdown=1
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
