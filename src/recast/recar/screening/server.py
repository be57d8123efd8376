"""The page of the screening over HTTP, for browsers on this machine only."""

from __future__ import annotations

import errno
import json
import re
import sys
from collections.abc import Callable, Mapping
from functools import cache
from http.server import BaseHTTPRequestHandler, ThreadingHTTPServer
from importlib.resources import files
from typing import Any
from urllib.parse import parse_qsl, unquote, urlsplit

from recast.core.errors import InputError
from recast.core.files import parse_json
from recast.recar.screening.service import RefusedError, ScreeningService

CONTENT_POLICY = (
    "default-src 'none'; img-src 'self' data:; connect-src 'self'; style-src 'unsafe-inline'; "
    "script-src 'unsafe-inline'; base-uri 'none'; form-action 'none'; frame-ancestors 'none'"
)
"""What the browser lets the page do: ask its own server, nothing else."""
HOST = "127.0.0.1"
_NAMES = (HOST, "localhost")
_LENGTH = re.compile("[0-9]{1,4}")  # of a body


@cache
def page() -> bytes:
    """HTML with style and script inside."""
    folder = files("recast.recar.screening") / "web"
    text = (folder / "page.html").read_text(encoding="utf-8")
    for name, mark in (("page.css", "/* STYLE */"), ("page.js", "/* SCRIPT */")):
        text = text.replace(mark, (folder / name).read_text(encoding="utf-8"))
    return text.encode()


class ScreeningServer(ThreadingHTTPServer):
    """Serves one cache on 127.0.0.1 until `shutdown`.

    Args:
        service: of the cache.
        port: 0 takes any that is free, see `url`.

    Raises:
        InputError: the port is taken, or may not be used.
    """

    daemon_threads = True

    def __init__(self, service: ScreeningService, port: int) -> None:
        self.service = service
        try:
            super().__init__((HOST, port), _Handler)
        except (OSError, OverflowError) as error:
            taken = getattr(error, "errno", None) == errno.EADDRINUSE
            problem = "is taken by another program" if taken else f"cannot be used ({error})"
            raise InputError("--port", str(port), problem, "name another, or 0 for any") from None

    @property
    def url(self) -> str:
        """Address of the page."""
        return f"http://{HOST}:{self.server_address[1]}/"

    def handle_error(self, request: Any, client_address: Any) -> None:
        """Say nothing of browsers that leave while a picture is on its way."""
        if not isinstance(sys.exc_info()[1], ConnectionError):
            super().handle_error(request, client_address)


class _Handler(BaseHTTPRequestHandler):
    protocol_version = "HTTP/1.1"
    server_version = "recast"
    sys_version = ""
    disable_nagle_algorithm = True
    server: ScreeningServer

    def do_GET(self) -> None:
        self.close_connection |= self._has_body()  # which is not read
        self._answer(self._get)

    def do_POST(self) -> None:
        self._answer(self._post)

    def _answer(self, act: Callable[[], None]) -> None:
        try:
            self._check_origin()
            act()
        except RefusedError as refused:
            self._send_json(refused.answer, refused.status)
        except InputError as error:
            self._send_json({"error": str(error)}, 500)

    def _get(self) -> None:
        service = self.server.service
        try:
            parts = urlsplit(self.path)
        except ValueError:
            raise RefusedError(400, "address: is none") from None
        if parts.path == "/":
            self._send(page(), "text/html; charset=utf-8")
            return
        if parts.path.startswith("/picture/"):
            name, _, kind = parts.path.removeprefix("/picture/").rpartition("/")
            name = unquote(name)
            sheet = kind == "turntable"
            data = service.preview(name) if sheet else service.input_view(name, kind)
            self._send(data, "image/png")
            return
        answers: Mapping[str, Callable[[Mapping[str, str]], dict[str, Any]]] = {
            "/api/state": lambda _: service.state(),
            "/api/items": service.items,
            "/api/search": service.search,
            "/api/news": service.news,
        }
        if parts.path not in answers:
            raise RefusedError(404, "no such page")
        self._send_json(answers[parts.path](dict(parse_qsl(parts.query))))

    def _post(self) -> None:
        body = self._body()
        answers = {"/api/decide": self.server.service.decide, "/api/undo": self.server.service.undo}
        if self.path not in answers:
            raise RefusedError(404, "no such page")
        self._send_json(answers[self.path](body))

    def _check_origin(self) -> None:
        # Other sites in the same browser can send requests here, under their own names (Origin) or,
        # with a name of theirs that leads to 127.0.0.1, as if from here (Host). Programs at other
        # ports of this machine are other sites. The port is not compared with our own: behind a
        # tunnel the browser knows another one.
        host = self.headers.get("Host", "")
        foreign = [one for one in self.headers.get_all("Origin", []) if one != f"http://{host}"]
        if foreign or _host(host) not in _NAMES:
            self.close_connection = True
            raise RefusedError(403, "only pages of this server may ask it")

    def _has_body(self) -> bool:
        return "Content-Length" in self.headers or "Transfer-Encoding" in self.headers

    def _body(self) -> dict[str, Any]:
        length = self.headers.get("Content-Length", "")
        if not _LENGTH.fullmatch(length) or "Transfer-Encoding" in self.headers:
            self.close_connection = True  # what follows was not read
            raise RefusedError(400, "body: its length is missing or too large")
        data = self.rfile.read(int(length))
        if self.headers.get_content_type() != "application/json":
            raise RefusedError(415, "body: is no application/json")
        try:
            body = parse_json("body", data)
        except InputError as error:
            raise RefusedError(400, f"body: {error.problem}") from None
        if not isinstance(body, dict):
            raise RefusedError(400, "body: is no JSON object")
        return body

    def _send_json(self, value: Mapping[str, Any], status: int = 200) -> None:
        self._send(json.dumps(value).encode(), "application/json", status)

    def _send(self, data: bytes, kind: str, status: int = 200) -> None:
        self.send_response(status)
        self.send_header("Content-Type", kind)
        self.send_header("Content-Length", str(len(data)))
        self.send_header("Cache-Control", "no-store")
        self.send_header("Content-Security-Policy", CONTENT_POLICY)
        self.send_header("X-Content-Type-Options", "nosniff")
        self.end_headers()
        self.wfile.write(data)

    def log_message(self, format: str, *args: Any) -> None:
        """Keep the terminal free."""


def _host(address: str) -> str | None:
    try:
        return urlsplit(f"//{address}").hostname
    except ValueError:
        return None
