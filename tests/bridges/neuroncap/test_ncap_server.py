"""recast as NeuroNCAP's renderer: images of requests, and one clear status for what is none."""

from __future__ import annotations

import http.client
import json
import logging
import socket
from collections.abc import Iterator
from concurrent.futures import ThreadPoolExecutor
from typing import Any

import cv2
import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from recast.core.web_server import WebServer
from recast.geometry import se3
from recast.scene.street_scene import SceneRasterizer
from recast.simulation.scene_renderer import draw_image
from recast_bridges.neuroncap import NcapService, ncap_app
from recast_bridges.neuroncap import service as module
from recast_bridges.rendering import ScenePainter, ServedScene
from recast_bridges.requests import RefusedError
from support.fake_neuroncap import image_of
from support.tiny_served import (
    CAMERA,
    MOUNTS,
    MOVING,
    PARKED,
    RIG_FROM_CAMERA,
    SCENE,
    TIMES,
    ahead,
    make_log,
    make_scene,
)

LOG = make_log()
STREET = make_scene(LOG)
RASTERIZER = SceneRasterizer(STREET, "cpu")
OFFSET = np.array([664_430.0, 3_998_000.0, 12.0])  # such as nuScenes' and UTM's
WORLD_FROM_LOCAL = se3.from_rotation_translation(np.eye(3), -OFFSET)
LOCAL_FROM_WORLD = se3.inverse(WORLD_FROM_LOCAL)
POSE = ahead(np.array([3.0]), 0.5)[0] @ RIG_FROM_CAMERA
TIME = 7_000_000
CARS = {MOVING: ahead(np.array([31.0]), -2.0)[0], PARKED: STREET.standing[PARKED]}


def make_service() -> NcapService:
    scene = ServedScene(STREET, MOUNTS, WORLD_FROM_LOCAL, int(TIMES[0]))
    return NcapService(ScenePainter({SCENE: scene}, "cpu"), SCENE)


SERVICE = make_service()


class Engine:
    """What NeuroNCAP's engine sends."""

    def __init__(self, port: int) -> None:
        self.port = port

    def send(
        self, method: str, path: str, body: Any = None, kind: str = "application/json"
    ) -> tuple[int, str, bytes]:
        connection = http.client.HTTPConnection("127.0.0.1", self.port, timeout=60)
        try:
            data = body if isinstance(body, bytes) or body is None else json.dumps(body).encode()
            connection.request(method, path, data, {"Content-Type": kind})
            response = connection.getresponse()
            return response.status, response.headers.get("Content-Type", ""), response.read()
        finally:
            connection.close()

    def get(self, path: str) -> Any:
        status, _, data = self.send("GET", path)
        assert status == 200, data
        return json.loads(data)

    def image(self, **changes: Any) -> np.ndarray:
        status, kind, data = self.send("POST", "/render_image", asked(**changes))
        assert status == 200 and kind.partition(";")[0] == "text/plain", data
        return image_of(data.decode())


def asked(**changes: Any) -> dict[str, Any]:
    pose = (LOCAL_FROM_WORLD @ POSE).tolist()
    return {"pose": pose, "timestamp": TIME, "camera_name": "front", **changes}


def moved(uuid: str, x: float, left: float, **changes: Any) -> dict[str, Any]:
    """An actor that stands for two seconds."""
    poses = np.tile(LOCAL_FROM_WORLD @ ahead(np.array([x]), left)[0], (2, 1, 1)).tolist()
    times = [TIME - 1_000_000, TIME + 1_000_000]
    one = {"timestamps": times, "poses": poses, "dims": [1.8, 4.2, 1.6], "uuid": uuid}
    return {**one, "is_target_actor": True, **changes}


def drawn(**poses: np.ndarray) -> np.ndarray:
    return draw_image(RASTERIZER, CAMERA, se3.inverse(POSE), poses, TIME)


@pytest.fixture
def engine() -> Iterator[Engine]:
    with WebServer(ncap_app(make_service()), "127.0.0.1", 0).in_background() as server:
        yield Engine(server.port)


@pytest.fixture(scope="module")
def shared() -> Iterator[Engine]:
    """One server for all that change nothing."""
    with WebServer(ncap_app(make_service()), "127.0.0.1", 0).in_background() as server:
        yield Engine(server.port)


def test_bodies_of_the_questions_without_one(shared: Engine) -> None:
    assert shared.send("GET", "/alive") == (200, "application/json", b"true")
    assert shared.send("GET", "/start_time") == (200, "application/json", b"5000000")
    moving, parked = shared.get("/get_actors")
    assert list(parked) == ["uuid", "poses", "timestamps", "dims"]
    assert parked["uuid"] == PARKED and parked["dims"] == [1.8, 4.2, 1.6]
    assert parked["timestamps"] == [5_000_000, 25_000_000]
    pose = [[1, 0, 0, 664_444.0], [0, 1, 0, 3_998_004.0], [0, 0, 1, 12.8], [0, 0, 0, 1]]
    assert parked["poses"] == [pose, pose]
    assert (moving["uuid"], len(moving["poses"]), len(moving["timestamps"])) == (MOVING, 201, 201)


def test_an_image_is_the_one_drawn_in_process(shared: Engine) -> None:
    """Coordinates of 4e6 m in float64: poses are off by 1e-9 m, which one value in all may show."""
    apart = np.abs(shared.image().astype(int) - drawn(**CARS))
    assert apart.max() <= 1 and (apart > 0).sum() <= 2
    assert drawn(**CARS).std() > 20  # there is something to see


def test_formats(shared: Engine) -> None:
    raw = shared.image()
    found = {}
    for name in ("png", "jpg", "jpeg"):
        status, kind, data = shared.send("POST", "/render_image", asked(image_format=name))
        assert status == 200
        pixels = cv2.imdecode(np.frombuffer(data, np.uint8), cv2.IMREAD_COLOR)
        found[name] = kind.partition(";")[0], cv2.cvtColor(pixels, cv2.COLOR_BGR2RGB)
    assert {name: kind for name, (kind, _) in found.items()} == {
        "png": "image/png", "jpg": "text/jpeg", "jpeg": "text/jpeg",
    }  # fmt: skip
    np.testing.assert_array_equal(found["png"][1], raw)
    np.testing.assert_array_equal(found["jpg"][1], found["jpeg"][1])
    assert np.abs(found["jpg"][1].astype(int) - raw).mean() < 10


def test_cameras_have_their_names_with_and_without_cam(shared: Engine) -> None:
    plain = shared.image()
    for name in ("CAM_front", "CAM_FRONT", "FRONT"):
        np.testing.assert_array_equal(shared.image(camera_name=name), plain)
    bent = shared.image(camera_name="CAM_BENT")
    assert bent.shape == (30, 40, 3) and bent.std() > 10


def close(found: np.ndarray, wanted: np.ndarray) -> bool:
    apart = np.abs(found.astype(int) - wanted)
    return bool(apart.max() <= 1 and (apart > 0).sum() <= 2)


def test_actors_are_where_the_engine_puts_them(engine: Engine) -> None:
    update = [moved(MOVING, 14.0, -1.0)]
    assert engine.send("POST", "/update_actors", update) == (200, "application/json", b"null")
    there = ahead(np.array([14.0]), -1.0)[0]
    assert close(engine.image(), drawn(**{MOVING: there}))
    [one] = engine.get("/get_actors")
    assert one["uuid"] == MOVING and one["poses"] == update[0]["poses"]
    # Out of its time it is gone. The parked one, which nobody moved, is part of the street.
    late = TIME + 1_000_001
    assert close(engine.image(timestamp=late), drawn()) and not close(drawn(), drawn(**CARS))
    engine.send("POST", "/update_actors", [moved(PARKED, 9.0, 2.0)])
    assert close(engine.image(), drawn(**{PARKED: ahead(np.array([9.0]), 2.0)[0]}))
    assert engine.send("POST", "/update_actors", [])[0] == 200
    assert close(engine.image(), drawn()) and engine.get("/get_actors") == []


def test_between_its_poses_an_actor_is_in_between(engine: Engine) -> None:
    poses = (LOCAL_FROM_WORLD @ ahead(np.array([10.0, 18.0]), -1.0)).tolist()
    engine.send("POST", "/update_actors", [moved(MOVING, 0.0, 0.0, poses=poses)])
    assert close(engine.image(), drawn(**{MOVING: ahead(np.array([14.0]), -1.0)[0]}))


TURNED = [[2.0, 0, 0, 0], [0, 1, 0, 0], [0, 0, 1, 0], [0, 0, 0, 1]]
IMAGES, UPDATES = "/render_image", "/update_actors"


@pytest.mark.parametrize(
    ("path", "body", "problem"),
    [
        (IMAGES, [], "request: is not a JSON object"),
        (IMAGES, {}, "pose: is missing"),
        (IMAGES, asked(pose=[[1, 2], [3]]), "pose: is not an array of 4x4 numbers"),
        (IMAGES, asked(pose=np.eye(3).tolist()), "pose: is not an array of 4x4 numbers"),
        (IMAGES, asked(pose="1"), "pose: is not an array of 4x4 numbers"),
        (IMAGES, asked(pose=[[True] * 4] * 4), "pose: is not an array of 4x4 numbers"),
        (IMAGES, asked(pose=TURNED), "pose: the upper left 3x3 block is not a rotation"),
        (IMAGES, asked(pose=(1e8 * np.ones((4, 4))).tolist()), "pose: 1e+08 is not within"),
        (IMAGES, asked(timestamp=1.5), "timestamp: 1.5 is not a time in microseconds"),
        (IMAGES, asked(timestamp=-1), "timestamp: -1 is not a time"),
        (IMAGES, asked(timestamp=10**40), "timestamp: 1000000"),
        (IMAGES, asked(camera_name="CAM_REAR"), "camera_name: 'CAM_REAR' is not one of front"),
        (IMAGES, asked(camera_name=None), "camera_name: 'None' is not one of"),
        (IMAGES, asked(image_format="gif"), "image_format: 'gif' is not one of raw, png, jpg"),
        (IMAGES, asked(image_format=[]), "image_format: '[]' is not one of"),
        (UPDATES, {}, "actors: is not a list"),
        (UPDATES, [1], "actors[0]: is not a JSON object"),
        (UPDATES, [{}], "actors[0].uuid: is missing"),
        (UPDATES, [moved("car-z", 0, 0)], "actors[0].uuid: 'car-z' is not an actor of the scene"),
        (UPDATES, [moved(MOVING, 0, 0)] * 2, "actors[1].uuid: 'car-a' is given twice"),
        (UPDATES, [moved(MOVING, 0, 0, poses=[])], "actors[0].poses: is not an array of Nx4x4"),
        (UPDATES, [moved(MOVING, 0, 0, poses=[TURNED] * 2)], "actors[0].poses: the upper left"),
        (UPDATES, [moved(MOVING, 0, 0, timestamps=[1])], "actors[0].poses: expected (1, 4, 4)"),
        (UPDATES, [moved(MOVING, 0, 0, timestamps=[2, 2])], "timestamps_us: must increase"),
        (UPDATES, [moved(MOVING, 0, 0, timestamps=["1", 2])], "actors[0].timestamps: 1 is not a"),
        (UPDATES, [moved(MOVING, 0, 0, dims=[1.0, 2.0])], "actors[0].dims: is not an array of 3"),
        (UPDATES, [moved(MOVING, 0, 0, dims=[0.0, 1, 1])], "actors[0].dims: are not three lengths"),
        (IMAGES, b'{"pose": NaN}', "body: cannot be read"),
        (IMAGES, b"\xff", "body: cannot be read"),
        (IMAGES, b"[" * 100_000, "body: is nested too deeply"),
    ],
)  # fmt: skip
def test_a_bad_request_is_refused_with_its_member(
    shared: Engine, path: str, body: Any, problem: str
) -> None:
    status, kind, data = shared.send("POST", path, body)
    detail = json.loads(data)["detail"]
    assert (status, kind) == (400, "application/json")
    assert problem in detail and "\n" not in detail and len(detail) <= 300
    assert [one["uuid"] for one in shared.get("/get_actors")] == [MOVING, PARKED]


def test_other_refusals(shared: Engine, monkeypatch: pytest.MonkeyPatch) -> None:
    for method, path, status in (
        ("GET", "/", 404),
        ("POST", "/infer", 404),
        ("GET", "/render_image", 405),
        ("POST", "/alive", 405),
    ):
        found, _, data = shared.send(method, path, None if method == "GET" else {})
        assert found == status and path in json.loads(data)["detail"]
    assert shared.send("POST", "/set_actor_scale", 1.1)[0] == 501
    assert shared.send("POST", "/render_image", b"{}", "text/plain")[0] == 415
    monkeypatch.setattr(module, "MOST_BODY", 1000)
    assert shared.send("POST", "/update_actors", [1] * 1000)[0] == 413
    assert shared.get("/alive") is True


def test_a_fault_of_recast_is_told_as_one(
    shared: Engine, monkeypatch: pytest.MonkeyPatch, caplog: pytest.LogCaptureFixture
) -> None:
    def fails(*_: object) -> Any:
        raise MemoryError("no room")

    monkeypatch.setattr(ScenePainter, "draw", fails)
    with caplog.at_level(logging.ERROR, logger=module.__name__):
        status, _, data = shared.send("POST", "/render_image", asked())
    assert (status, json.loads(data)["detail"]) == (
        500, "/render_image failed; the server's log says why",
    )  # fmt: skip
    assert "no room" in caplog.text
    monkeypatch.undo()
    assert close(shared.image(), drawn(**CARS))


def test_clients_that_die_or_send_no_http_disturb_nobody(shared: Engine) -> None:
    place = "127.0.0.1", shared.port
    for sent in (
        b"",
        b"POST /render_image HTTP/1.1\r\nHost: x\r\nContent-Type: application/json\r\n"
        b"Content-Length: 100\r\n\r\n{",
        b"\x16\x03\x01\x02\x00 no HTTP\r\n\r\n",
        b"GET /" + b"a" * 200_000,
    ):
        with socket.create_connection(place, timeout=60) as caller:
            caller.sendall(sent)
    with socket.create_connection(place, timeout=60) as slow:
        slow.sendall(b"POST /update_actors HTTP/1.1\r\nHost: x\r\n")
        assert close(shared.image(), drawn(**CARS))


def test_many_clients_at_once_get_their_own_images(shared: Engine) -> None:
    places = [
        (LOCAL_FROM_WORLD @ ahead(np.array([x]), 0.5)[0] @ RIG_FROM_CAMERA) for x in range(12)
    ]
    alone = [shared.image(pose=pose.tolist()) for pose in places]
    with ThreadPoolExecutor(12) as pool:
        found = list(pool.map(lambda pose: shared.image(pose=pose.tolist()), places))
    for one, other in zip(found, alone, strict=True):
        np.testing.assert_array_equal(one, other)


JSON = st.recursive(
    st.none() | st.booleans() | st.integers() | st.floats(allow_nan=False) | st.text(max_size=5),
    lambda inner: st.lists(inner, max_size=5) | st.dictionaries(st.text(max_size=4), inner),
    max_leaves=20,
)
MEMBERS = ["pose", "timestamp", "camera_name", "image_format"]
ACTOR = ["uuid", "poses", "timestamps", "dims"]


@settings(deadline=None, max_examples=150)
@given(st.data())
def test_whatever_is_sent_is_answered_or_refused(data: st.DataObject) -> None:
    service, one = SERVICE, moved(MOVING, 14.0, -1.0)
    for key in data.draw(st.sets(st.sampled_from(ACTOR))):
        one[key] = data.draw(JSON)
    view = asked()
    for key in data.draw(st.sets(st.sampled_from(MEMBERS))):
        view[key] = data.draw(JSON)
    for answer, value in ((service.update, [one]), (service.image, view)):
        try:
            answer(value)
        except RefusedError as refused:
            assert refused.code == "INVALID_ARGUMENT" and "\n" not in refused.details
