"""Who may ask a server of recast, and requests that never end."""

from __future__ import annotations

import logging
import socket
from collections.abc import Iterator

import pytest
from starlette.applications import Starlette
from starlette.requests import Request
from starlette.responses import PlainTextResponse
from starlette.routing import Route

from recast.core import web_server
from recast.core.web_server import WebServer, refusal_of

HOST = socket.gethostname().lower()


@pytest.mark.parametrize(
    ("listening", "host", "origin", "names"),
    [
        ("127.0.0.1", "127.0.0.1:8080", None, ()),
        ("127.0.0.1", "LOCALHOST", "http://localhost", ()),
        ("127.0.0.1", "localhost.:1", "http://localhost.:1", ()),
        ("localhost", "[::1]:8080", "http://[::1]:8080", ()),
        ("::1", "[::1]", None, ()),
        ("0.0.0.0", "192.0.2.7:8000", None, ()),
        ("0.0.0.0", f"{HOST}:8000", f"http://{HOST}:8000", ()),
        ("192.0.2.7", "192.0.2.7", "http://192.0.2.7", ()),
        ("render.lan", "render.lan:80", None, ()),
        ("0.0.0.0", "renderer:8000", None, ("renderer",)),
        ("127.0.0.1", "me.example.org", "https://me.example.org", ("me.example.org",)),
    ],
)
def test_programs_and_own_pages_may_ask(
    listening: str, host: str, origin: str | None, names: tuple[str, ...]
) -> None:
    assert refusal_of(listening, [host], [] if origin is None else [origin], names) is None


@pytest.mark.parametrize(
    ("listening", "host", "origin"),
    [
        ("127.0.0.1", "evil.example.org", None),  # a name that leads to 127.0.0.1
        ("127.0.0.1", "evil.example.org:8080", "http://evil.example.org:8080"),
        ("127.0.0.1", "127.0.0.1.evil.example.org", None),
        ("127.0.0.1", "192.0.2.7", None),
        ("127.0.0.1", "127.0.0.1@evil.example.org", None),
        ("127.0.0.1", "", None),
        ("127.0.0.1", "[::1", None),
        ("0.0.0.0", "evil.example.org", None),
        ("127.0.0.1", "127.0.0.1:8080", "http://evil.example.org"),
        ("127.0.0.1", "127.0.0.1:8080", "http://127.0.0.1:8081"),
        ("127.0.0.1", "127.0.0.1:8080", "https://127.0.0.1:8080"),
        ("127.0.0.1", "localhost:8080", "null"),
        ("127.0.0.1", "localhost:8080", ""),
    ],
)
def test_other_sites_may_not(listening: str, host: str, origin: str | None) -> None:
    assert refusal_of(listening, [host], [] if origin is None else [origin]) is not None


def test_a_host_is_named_once() -> None:
    assert refusal_of("127.0.0.1", [], []) is not None
    assert refusal_of("127.0.0.1", ["localhost", "localhost"], []) is not None


@pytest.fixture
def port(monkeypatch: pytest.MonkeyPatch) -> Iterator[int]:
    def fail(request: Request) -> PlainTextResponse:
        raise ArithmeticError("of a fault")

    monkeypatch.setattr(web_server, "_HEADER_SECONDS", 0.3)
    app = Starlette(routes=[Route("/", lambda _: PlainTextResponse("here")), Route("/fail", fail)])
    with WebServer(app, "127.0.0.1", 0).in_background() as server:
        yield server.port


def answer(port: int, *parts: bytes) -> bytes:
    """All that comes until the server closes the connection."""
    with socket.create_connection(("127.0.0.1", port), timeout=30) as stream:
        for part in parts:
            stream.sendall(part)
        return b"".join(iter(lambda: stream.recv(1 << 16), b""))


def test_the_application_is_behind_the_check(port: int) -> None:
    close = b"GET / HTTP/1.1\r\nConnection: close\r\nHost: "
    assert answer(port, close + b"localhost\r\n\r\n").endswith(b"here")
    foreign = answer(port, close + b"example.org\r\n\r\n")
    assert foreign.startswith(b"HTTP/1.1 403 ") and b"not a name of this server" in foreign
    other = answer(port, close + b"localhost\r\nOrigin: http://example.org\r\n\r\n")
    assert other.startswith(b"HTTP/1.1 403 ") and b"here" not in other


def test_headers_that_never_end_are_not_waited_for(port: int) -> None:
    assert answer(port) == b""
    assert answer(port, b"GET / HTTP/1.1\r\nHost: loc") == b""
    with socket.create_connection(("127.0.0.1", port), timeout=30) as stream:
        stream.sendall(b"GET / HTTP/1.1\r\nHost: localhost\r\n\r\n")
        received = b""
        while not received.endswith(b"here"):
            received += stream.recv(1 << 16)
        stream.sendall(b"GET / HT")  # nor those of a second request on the same connection
        assert stream.recv(1 << 16) == b""


def test_a_fault_is_in_the_log(port: int, caplog: pytest.LogCaptureFixture) -> None:
    with caplog.at_level(logging.ERROR, "recast"):
        asked = b"GET /fail HTTP/1.1\r\nHost: localhost\r\nConnection: close\r\n\r\n"
        assert answer(port, asked).startswith(b"HTTP/1.1 500 ")
    assert "/fail failed" in caplog.text and "of a fault" in caplog.text
