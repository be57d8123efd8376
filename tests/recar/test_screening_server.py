"""The page of the screening, asked as a browser asks it."""

from __future__ import annotations

import errno
import http.client
import json
import multiprocessing
import re
import socket
import threading
import time
from collections.abc import Iterator
from multiprocessing.connection import Connection
from pathlib import Path
from typing import Any
from urllib.parse import quote, urlencode, urlsplit

import cv2
import numpy as np
import pytest
import torch

from recast.core.errors import InputError
from recast.recar.screening import Screening
from recast.recar.screening.server import ScreeningServer
from recast.recar.screening.service import ScreeningService
from recast.recar.targets import Target, TargetCache, TargetCandidate
from recast.recar.targets.maker import contact_sheet
from recast.recar.targets.views import Viewpoint
from recast.splats import Gaussians

from .screenings import SCORES, write_cache
from .sets import pictures, write_set

JSON = {"Content-Type": "application/json"}


class Page:
    """What a page in a browser can ask."""

    def __init__(self, url: str) -> None:
        self.address = urlsplit(url).netloc

    def send(
        self,
        method: str,
        path: str,
        body: bytes | None = None,
        headers: dict[str, str] | None = None,
    ) -> tuple[int, http.client.HTTPMessage, bytes]:
        connection = http.client.HTTPConnection(self.address, timeout=10)
        try:
            connection.request(method, path, body, headers or {})
            response = connection.getresponse()
            return response.status, response.headers, response.read()
        finally:
            connection.close()

    def get(self, path: str, **query: object) -> Any:
        status, _, data = self.send("GET", f"{path}?{urlencode(query)}")
        assert status == 200, data
        return json.loads(data)

    def post(self, path: str, **body: object) -> tuple[int, Any]:
        status, _, data = self.send("POST", path, json.dumps(body).encode(), JSON)
        return status, json.loads(data)

    def ids(self, **query: object) -> list[str]:
        return [item["id"] for item in self.get("/api/items", **query)["items"]]


@pytest.fixture
def cache(tmp_path: Path) -> TargetCache:
    return write_cache(tmp_path / "cache")


@pytest.fixture
def page(cache: TargetCache, tmp_path: Path) -> Iterator[Page]:
    with ScreeningServer(ScreeningService(cache, write_set(tmp_path / "set")), 0) as server:
        thread = threading.Thread(target=server.serve_forever)
        thread.start()
        yield Page(server.url)
        server.should_exit = True
        thread.join()


def stored(cache: TargetCache) -> dict[str, str]:
    found: dict[str, str] = json.loads((cache.folder / "screening.json").read_text())["decisions"]
    return found


def test_the_page_needs_no_other_file(page: Page) -> None:
    status, headers, data = page.send("GET", "/")
    text = data.decode()
    assert status == 200
    assert headers["Content-Type"] == "text/html; charset=utf-8"
    assert "addEventListener" in text
    assert "/* S" not in text  # style and script were put in
    assert not re.search(r"""(src|href)\s*=\s*["'](?!data:)|@import|https?://""", text)
    assert "default-src 'none'" in headers["Content-Security-Policy"]


def test_state_of_the_cache(page: Page) -> None:
    state = page.get("/api/state")
    assert (state["total"], state["failures"], state["threshold"]) == (4, 1, 4.5)
    assert state["sides"] == ["front", "rear", "left", "right"]


def test_targets_are_sorted_and_filtered_by_their_score(page: Page) -> None:
    assert page.ids(order="lowest") == ["car-10", "car-1", "car-2", "car-0"]
    assert page.ids(order="highest", limit=2) == ["car-0", "car-2"]
    assert page.ids(order="id") == ["car-0", "car-1", "car-10", "car-2"]
    assert page.ids(order="lowest", lowest=4.5, after="car-2") == ["car-0"]
    assert page.ids(order="lowest", before="car-0", limit=1) == ["car-2"]
    assert page.ids(at="car-10", lowest=4.5) == ["car-10"]
    item = page.get("/api/items", at="car-1")["items"][0]
    assert (item["score"], item["turned"], item["decision"]) == (4.2, 5.0, None)
    assert page.get("/api/search", text="car-1")["ids"] == ["car-1", "car-10"]


def test_a_decision_is_in_the_file_when_it_is_answered(page: Page, cache: TargetCache) -> None:
    status, answer = page.post("/api/decide", id="car-0", decision="accept", since=0, lowest=4.5)
    assert (status, answer["changes"], stored(cache)) == (
        200,
        {"car-0": "accept"},
        {"car-0": "accept"},
    )
    assert answer["counts"] == {"accept": 1, "reject": 0, "undecided": 1, "all": 2}
    page.post("/api/decide", id="car-1", decision="reject")
    assert page.ids(show="undecided") == ["car-10", "car-2"]
    assert page.ids(show="reject") == ["car-1"]
    status, answer = page.post("/api/undo")
    assert (answer["undone"], stored(cache)) == ("car-1", {"car-0": "accept"})
    page.post("/api/undo")
    assert page.post("/api/undo")[1]["undone"] is None
    assert stored(cache) == {}


def test_the_cache_uses_what_was_decided(page: Page, cache: TargetCache) -> None:
    page.post("/api/decide", id="car-0", decision="reject")
    page.post("/api/decide", id="car-1", decision="accept")
    opened = TargetCache.open(cache.folder)
    assert opened.decisions == {"car-0": "reject", "car-1": "accept"}
    assert opened.ids() == ("car-2",)  # car-1 stays below the threshold


def test_two_pages_lose_nothing(page: Page, cache: TargetCache) -> None:
    page.post("/api/decide", id="car-0", decision="accept", since=0)
    status, answer = page.post("/api/decide", id="car-2", decision="reject", since=0)
    assert status == 200
    assert answer["changes"] == {"car-0": "accept", "car-2": "reject"}
    status, answer = page.post("/api/decide", id="car-0", decision="reject", since=0)
    assert status == 409
    assert answer["changes"]["car-0"] == "accept"
    assert "elsewhere" in answer["error"]
    status, _ = page.post("/api/undo", since=1)
    assert status == 409
    assert stored(cache) == {"car-0": "accept", "car-2": "reject"}
    status, _ = page.post("/api/decide", id="car-0", decision="reject", since=answer["revision"])
    assert (status, stored(cache)["car-0"]) == (200, "reject")
    assert page.get("/api/news", since=2)["changes"] == {"car-0": "reject"}


@pytest.mark.parametrize(
    ("body", "status"),
    [
        ({"id": "car-9", "decision": "accept"}, 404),
        ({"id": "failed", "decision": "accept"}, 404),
        ({"id": "../car-0", "decision": "accept"}, 404),
        ({"id": ["car-0"], "decision": "accept"}, 404),
        ({"decision": "accept"}, 404),
        ({"id": "car-0", "decision": "maybe"}, 400),
        ({"id": "car-0", "decision": "flip"}, 400),
        ({"id": "car-0", "decision": ["accept"]}, 400),
        ({"id": "car-0", "decision": "accept", "since": "x"}, 400),
        ({"id": "car-0", "decision": "accept", "since": float("inf")}, 400),
    ],
)
def test_wrong_decisions_are_refused(
    page: Page, cache: TargetCache, body: dict[str, Any], status: int
) -> None:
    found, answer = page.post("/api/decide", **body)
    assert (found, set(answer)) == (status, {"error"})
    assert not (cache.folder / "screening.json").exists()


@pytest.mark.parametrize(
    "query", ["order=best", "show=good", "lowest=x", "highest=nan", "limit=x", "since=x"]
)
def test_wrong_questions_are_refused(page: Page, query: str) -> None:
    assert page.send("GET", f"/api/items?{query}")[0] == 400


def test_pictures(page: Page, cache: TargetCache) -> None:
    status, headers, data = page.send("GET", "/picture/car-0/turntable")
    assert (status, headers["Content-Type"]) == (200, "image/png")
    assert data == cache.preview_path("car-0").read_bytes()
    # A set of four views, ahead, left, behind, right.
    for side, view in (("front", 0), ("left", 1), ("rear", 2), ("right", 3)):
        data = page.send("GET", f"/picture/car-1/{side}")[2]
        shown = cv2.imdecode(np.frombuffer(data, np.uint8), cv2.IMREAD_UNCHANGED)
        np.testing.assert_array_equal(shown[16, 16, [2, 1, 0, 3]], pictures(1)[view][16, 16])
    assert page.send("GET", "/picture/car-10/front")[0] == 404  # not in the set
    assert page.send("GET", "/picture/car-0/above")[0] == 404
    cache.preview_path("car-2").unlink()
    assert page.send("GET", "/picture/car-2/turntable")[0] == 404


@pytest.mark.parametrize(
    "path",
    [
        "/picture/../../secret/turntable",
        "/picture/../records/car-0.json",
        "/picture/%2e%2e%2f%2e%2e%2fsecret/turntable",
        f"/picture/{quote('../../secret', safe='')}/turntable",
        f"/picture/{quote('car-0/../../../secret', safe='')}/turntable",
        "/picture/car-0/..%2f..%2fsecret",
        "/picture//etc/passwd/turntable",
        "/picture/car-0%00/turntable",
        "/../cache.json",
        "/cache.json",
        "//etc/passwd",
        "/picture/",
    ],
)
def test_no_path_leads_out_of_the_pictures(page: Page, tmp_path: Path, path: str) -> None:
    (tmp_path / "secret.png").write_bytes(b"secret")
    status, _, data = page.send("GET", path)
    assert status == 404
    assert b"secret\n" not in data
    assert set(json.loads(data)) == {"error"}


def test_other_sites_are_refused(page: Page, cache: TargetCache) -> None:
    body = json.dumps({"id": "car-0", "decision": "reject"}).encode()
    ask = ("POST", "/api/decide", body)
    assert page.send(*ask, JSON | {"Origin": "http://example.org"})[0] == 403
    assert page.send(*ask, JSON | {"Host": "example.org"})[0] == 403
    assert page.send("GET", "/api/items", None, {"Host": "example.org:80"})[0] == 403
    # What a form of another site can send without asking first.
    assert page.send(*ask, {"Content-Type": "text/plain"})[0] == 415
    assert not (cache.folder / "screening.json").exists()
    assert page.send(*ask, JSON | {"Host": "localhost:1", "Origin": "http://localhost:1"})[0] == 200


def test_bodies_that_are_none_are_refused(page: Page) -> None:
    for body in (b"", b"{", b"[]", b"\xff"):
        assert page.send("POST", "/api/undo", body, JSON)[0] == 400
    assert page.send("POST", "/api/undo", b" " * 20_000, JSON)[0] == 413
    assert page.send("POST", "/api/else", b"{}", JSON)[0] == 404


def test_another_port_of_this_machine_may_not_decide(page: Page, cache: TargetCache) -> None:
    body = json.dumps({"id": "car-0", "decision": "reject"}).encode()
    name, port = page.address.split(":")
    for origin in (
        f"http://{name}:{int(port) + 1}",
        f"http://{name}",
        f"https://{page.address}",
        f"http://localhost:{port}",
        "null",
        "",
        f"http://{page.address}.example.org",
    ):
        status = page.send("POST", "/api/decide", body, JSON | {"Origin": origin})[0]
        assert status == 403, origin
    assert not (cache.folder / "screening.json").exists()
    own = JSON | {"Origin": f"http://{page.address}"}
    assert page.send("POST", "/api/decide", body, own)[0] == 200


def answer_to(page: Page, request: bytes) -> bytes:
    """What the server says to bytes that no client library would send."""
    host, port = page.address.split(":")
    with socket.create_connection((host, int(port)), timeout=10) as stream:
        stream.sendall(request)
        return b"".join(iter(lambda: stream.recv(1 << 16), b""))


@pytest.mark.parametrize(
    ("start", "headers", "body"),
    [
        ("GET http://[::1/ HTTP/1.1", "", ""),
        ("POST /api/decide HTTP/1.1", "Content-Length: " + "9" * 5000, "{}"),
        ("POST /api/decide HTTP/1.1", "Content-Length: -1", "{}"),
        ("POST /api/decide HTTP/1.1", "Content-Length: ²", "{}"),
        ("POST /api/decide HTTP/1.1", "Content-Length: 2\r\nTransfer-Encoding: chunked", "{}"),
        ("POST /api/decide HTTP/1.1", "Content-Length: 4000", "[" * 4000),
        ("POST /api/undo HTTP/1.1", "Content-Length: 411", '{"since": %s}' % ("9" * 400)),
        ("POST /api/undo HTTP/1.1", "Content-Length: 15", '{"since":1e999}'),
        ("POST /api/undo HTTP/1.1", "Content-Length: 13", '{"since":NaN}'),
        ("GET /api/items?limit=" + "9" * 400 + " HTTP/1.1", "", ""),
        ("GET /api/news?since=-" + "9" * 4400 + " HTTP/1.1", "", ""),
    ],
)
def test_what_no_page_sends_is_refused_in_words(
    page: Page, capfd: pytest.CaptureFixture[str], start: str, headers: str, body: str
) -> None:
    lines = [
        start,
        "Host: localhost",
        "Connection: close",
        "Content-Type: application/json",
        headers,
    ]
    head = "\r\n".join(line for line in lines if line) + "\r\n\r\n"
    answer = answer_to(page, (head + body).encode("latin-1"))
    assert answer.startswith(b"HTTP/1.1 400 "), answer[:200]
    # What is no HTTP does not reach the application.
    assert b'{"error":' in answer or answer.endswith(b"Invalid HTTP request received.")
    assert capfd.readouterr().err == ""
    assert page.get("/api/state")["total"] == 4


def test_decisions_on_a_read_only_disk_are_refused_in_words(
    page: Page, cache: TargetCache, monkeypatch: pytest.MonkeyPatch
) -> None:
    def refuse(path: Path, *args: object) -> None:
        raise OSError(errno.EROFS, "read-only", str(path))

    monkeypatch.setattr(Path, "touch", refuse)
    status, answer = page.post("/api/decide", id="car-0", decision="accept")
    assert status == 500 and "it is read-only" in answer["error"]
    assert not (cache.folder / "screening.json").exists()


def test_a_file_broken_meanwhile_is_told_and_kept(page: Page, cache: TargetCache) -> None:
    (cache.folder / "screening.json").write_text("{")
    status, answer = page.post("/api/decide", id="car-0", decision="accept")
    assert status == 500
    assert "screening.json: JSON" in answer["error"]
    assert (cache.folder / "screening.json").read_text() == "{"


def test_the_server_listens_to_this_machine_only(cache: TargetCache) -> None:
    with ScreeningServer(ScreeningService(cache), 0) as server:
        host, port = server.socket.getsockname()
        assert host == "127.0.0.1"
        with pytest.raises(InputError, match="is taken"):
            ScreeningServer(ScreeningService(cache), port)
    with pytest.raises(InputError, match="cannot be used"):
        ScreeningServer(ScreeningService(cache), 70000)


def test_nothing_to_screen_and_a_strange_set_are_refused(
    cache: TargetCache, tmp_path: Path
) -> None:
    with pytest.raises(InputError, match="none can be screened"):
        ScreeningService(write_cache(tmp_path / "empty", {}))
    made = write_set(tmp_path / "set")
    cache.record = cache.record.model_copy(update={"vehicle_set": "others"})
    with pytest.raises(InputError, match="the targets are of 'others'"):
        ScreeningService(cache, made)


def test_contact_sheets_have_the_tiles_that_the_page_cuts() -> None:
    one = torch.zeros(1, 3)
    gaussians = Gaussians(
        means=one,
        quats=torch.tensor([[1.0, 0, 0, 0]]),
        log_scales=one - 2.0,
        logit_opacities=torch.ones(1),
        sh=torch.zeros(1, 1, 3),
    )
    views = [Viewpoint(azimuth) for azimuth in (0.0, 180.0, 90.0, 270.0)]
    target = Target(
        np.zeros((1, 1, 1, 1), np.float32), np.zeros((1, 3), np.int32), np.zeros((1, 1), np.float32)
    )
    png = contact_sheet(TargetCandidate(target, gaussians, pictures(0), views))
    height, width = cv2.imdecode(np.frombuffer(png, np.uint8), cv2.IMREAD_COLOR).shape[:2]
    assert (width % 4, height % 3) == (0, 0)
    assert width // 4 == height // 3


def serve(folder: Path, url: Connection) -> None:
    server = ScreeningServer(ScreeningService(TargetCache.open(folder)), 0)
    url.send(server.url)
    server.serve_forever()


def test_kills_between_and_within_decisions_lose_none(tmp_path: Path) -> None:
    names = [f"car-{index}" for index in range(60)]
    folder = write_cache(tmp_path / "cache", dict.fromkeys(names, SCORES["car-0"])).folder
    answered: dict[str, str] = {}
    waiting = iter(names)
    fork = multiprocessing.get_context("fork")
    for kill in range(8):
        receiving, sending = fork.Pipe(duplex=False)
        process = fork.Process(target=serve, args=(folder, sending))
        process.start()
        page = Page(receiving.recv())
        for name in (next(waiting) for _ in range(1 + kill % 3)):
            assert page.post("/api/decide", id=name, decision="reject")[0] == 200
            answered[name] = "reject"
        # One more is on its way when the process dies: it is there, or it is not.
        late = next(waiting)
        body = json.dumps({"id": late, "decision": "accept"}).encode()
        head = f"POST /api/decide HTTP/1.1\r\nHost: localhost\r\nContent-Length: {len(body)}\r\n"
        host, port = page.address.split(":")
        with socket.create_connection((host, int(port))) as stream:
            stream.sendall(head.encode() + b"Content-Type: application/json\r\n\r\n" + body)
            time.sleep(0.0005 * kill)
            process.kill()
            process.join()
        found = dict(Screening(folder).decisions)
        assert found in (answered, answered | {late: "accept"})
        answered = {**found}
    screening = Screening(folder)
    assert screening.revision == len(answered)
    screening.decide("car-0", "accept")  # no lock is left behind
    assert Screening(folder).decision("car-0") == "accept"
