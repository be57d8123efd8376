"""Questions to another program over HTTP: every fault is one line, and nothing waits for ever."""

from __future__ import annotations

import json
import pickle
import socket
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from threading import Event, Thread
from typing import Any

import pytest
from starlette.applications import Starlette
from starlette.requests import Request
from starlette.responses import JSONResponse, Response
from starlette.routing import Route

from recast.core import web_server
from recast.core.errors import InputError
from recast.core.web_server import BodyError, WebServer, json_body
from recast_bridges.json_service import JsonService

MOST = 1000


async def echo(request: Request) -> Response:
    try:
        value = await json_body(request, MOST)
    except BodyError as error:
        return JSONResponse({"error": str(error)}, error.status)
    return JSONResponse({"got": value, "length": request.headers["Content-Length"]})


APP = Starlette(
    routes=[
        Route("/echo", echo, methods=["POST"]),
        Route("/here", lambda _: JSONResponse(True)),
        Route("/long", lambda _: JSONResponse("a" * MOST)),
        Route("/text", lambda _: Response("<html>")),
        Route("/broken", lambda _: Response("out of\nmemory\x1b[31m", 500)),
    ]
)


@pytest.fixture(scope="module")
def service() -> Iterator[JsonService]:
    with WebServer(APP, "127.0.0.1", 0).in_background() as server:
        yield JsonService.at(f"localhost:{server.port}", "planner x")


@contextmanager
def answering(answer: Callable[[socket.socket], None]) -> Iterator[JsonService]:
    """A program that answers its first caller in its own way, without a server of HTTP."""
    with socket.create_server(("127.0.0.1", 0)) as listening:

        def serve() -> None:
            caller, _ = listening.accept()
            with caller:
                caller.recv(1 << 16)
                answer(caller)

        thread = Thread(target=serve, daemon=True)
        thread.start()
        yield JsonService.at(f"127.0.0.1:{listening.getsockname()[1]}", "planner x")
        thread.join(10)


def get(service: JsonService, path: str = "/here", seconds: float = 20.0) -> Any:
    return service.ask("GET", path, seconds=seconds, most_bytes=MOST)


def test_an_answer_is_the_value_of_its_json(service: JsonService) -> None:
    assert get(service) is True
    value = {"x": [0.1, 1e-300, -0.0], "name": "é"}
    found = service.ask("POST", "/echo", value, seconds=20.0, most_bytes=MOST)
    assert found == {"got": value, "length": str(len(json.dumps(value).replace(" ", "")))}


@pytest.mark.parametrize(
    ("path", "problem"),
    [
        ("/long", "/long: its answer has more than 1000 bytes"),
        ("/text", "/text: its answer cannot be read"),
        ("/broken", r"/broken: answered 500 Internal Server Error: out of memory\x1b[31m;"),
        ("/nowhere", "/nowhere: answered 404"),
    ],
)
def test_what_is_no_answer_is_one_line(service: JsonService, path: str, problem: str) -> None:
    with pytest.raises(InputError) as error:
        get(service, path)
    line = str(error.value)
    assert line.startswith("planner x: ") and problem in line and "\n" not in line


def test_nobody_there() -> None:
    with socket.create_server(("127.0.0.1", 0)) as taken:
        port = taken.getsockname()[1]
    with pytest.raises(InputError, match="planner x: /here: no program listens there"):
        get(JsonService.at(f"127.0.0.1:{port}", "planner x"))


@pytest.mark.parametrize(
    "sent", [b"", b"HTTP/1.1 200 OK\r\nContent-Length: 50\r\n\r\ntrue", b"no HTTP\r\n\r\n"]
)
def test_a_program_that_dies_in_its_answer(sent: bytes) -> None:
    with (
        answering(lambda caller: caller.sendall(sent)) as service,
        pytest.raises(InputError, match=r"planner x: /here: (the connection failed|its answer)"),
    ):
        get(service)


@pytest.mark.parametrize("first", [b"", b"HTTP/1.1 200 OK\r\nContent-Length: 500\r\n\r\n"])
def test_an_answer_that_drips_is_late(first: bytes) -> None:
    """Each byte comes in time, all of them do not."""
    over = Event()

    def drip(caller: socket.socket) -> None:
        caller.sendall(first)
        while not over.wait(0.05):
            try:
                caller.sendall(b"H" if not first else b" ")
            except OSError:
                return

    with answering(drip) as service:
        with pytest.raises(InputError, match=r"/here: has not answered within 0\.5 s"):
            get(service, seconds=0.5)
        over.set()


@pytest.mark.parametrize(
    "address", ["", "localhost", "localhost:0", "localhost:70000", "http://a:1", "a b:1", "a:1/x"]
)
def test_an_address_is_a_host_and_a_port(address: str) -> None:
    with pytest.raises(InputError, match="is not an address; give HOST:PORT"):
        JsonService.at(address, "planner x")


def test_a_service_holds_nothing_open(service: JsonService) -> None:
    """So it can be sent to another process, before and after it was asked."""
    assert get(service) is True
    assert get(pickle.loads(pickle.dumps(service))) is True
    assert JsonService.at("[::1]:8000", "x").host == "::1"


def test_who_refuses_a_body_unread_is_heard(service: JsonService) -> None:
    for path, status in (("/here", 405), ("/nowhere", 404), ("/echo", 413)):
        with pytest.raises(InputError, match=f"{path}: answered {status}"):
            service.ask("POST", path, "a" * 30_000_000, seconds=20.0, most_bytes=MOST)


def test_a_server_refuses_what_is_no_body_it_takes(service: JsonService) -> None:
    with pytest.raises(InputError, match=r"413 .*has more than 1000 bytes"):
        service.ask("POST", "/echo", "a" * MOST, seconds=20.0, most_bytes=MOST)
    status = {}
    for kind, body in (
        ("text/plain", b"{}"),
        ("application/json", b"{"),
        ("application/json", b"1e999"),
    ):
        with socket.create_connection((service.host, service.port), timeout=20) as caller:
            head = "POST /echo HTTP/1.1\r\nHost: localhost\r\nConnection: close\r\n"
            head += f"Content-Type: {kind}\r\n"
            caller.sendall(f"{head}Content-Length: {len(body)}\r\n\r\n".encode() + body)
            status[body] = int(caller.recv(100).split()[1])
    assert status == {b"{}": 415, b"{": 400, b"1e999": 400}
    assert get(service) is True  # and goes on


def test_a_body_that_does_not_come_is_not_waited_for(
    service: JsonService, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(web_server, "_BODY_SECONDS", 0.2)
    with socket.create_connection((service.host, service.port), timeout=20) as caller:
        head = "POST /echo HTTP/1.1\r\nHost: localhost\r\nContent-Type: application/json\r\n"
        caller.sendall(f"{head}Content-Length: 5\r\n\r\n12".encode())
        assert caller.recv(100).split()[1] == b"408"


def test_a_port_that_is_taken_or_elsewhere_is_one_line(service: JsonService) -> None:
    for host, port in (("127.0.0.1", service.port), ("127.0.0.1", 70000), ("no.such.invalid", 0)):
        with pytest.raises(
            InputError, match=r"`port`: .*; choose another port, or 0 for a free one"
        ):
            WebServer(APP, host, port)
