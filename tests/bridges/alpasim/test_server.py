"""Server and client over a channel: the same images as in process, and faults of either side."""

from __future__ import annotations

import socket
import subprocess
import sys
from collections.abc import Callable, Iterator, Mapping, Sequence
from concurrent.futures import ThreadPoolExecutor
from contextlib import contextmanager
from threading import Event, Thread
from typing import Any, Literal

import grpc
import numpy as np
import pytest

from recast.arrays import Image
from recast.cameras import CameraMount, Lens
from recast.core.errors import InputError
from recast.geometry import se3
from recast.planning import ConstantVelocity, Plan, PlannerInput
from recast.scene.street_scene import SceneRasterizer
from recast.simulation import MOTIONS, Rollout, RolloutSetup, SensorRenderer, SimState, run_rollout
from recast.simulation.renderer import MountedRenderer
from recast.simulation.scene_renderer import SceneRenderer, draw_image, through_lenses
from recast_bridges.alpasim.client import SensorsimClient, SensorsimRenderer
from recast_bridges.alpasim.messages import (
    CHANNEL_OPTIONS,
    SENSORSIM_SERVICES,
    as_sent,
    message,
    parse,
)
from recast_bridges.alpasim.server import VERSION_ID
from recast_bridges.rendering import ScenePainter
from support.tiny_served import MOUNTS, MOVING, SCENE, make_log, make_scene, served, serving

PATH = SENSORSIM_SERVICES[0]
LOG = make_log()
QUICK = (0.05, 0.05)


@contextmanager
def pausing(client: SensorsimClient, pauses: Sequence[float]) -> Iterator[None]:
    kept, client._pauses = client._pauses, tuple(pauses)
    yield
    client._pauses = kept


class Looker(ConstantVelocity):
    """Keeps what it sees."""

    name, needs_images = "looker", True

    def __init__(self) -> None:
        super().__init__()
        self.seen: list[Mapping[str, Image]] = []

    def plan(self, observation: PlannerInput) -> Plan:
        self.seen.append(observation.images)
        return super().plan(observation)


class RoundedRenderer(MountedRenderer):
    """In process, with poses as the messages hold them: float32."""

    def __init__(self, mounts: Mapping[str, CameraMount]) -> None:
        super().__init__(mounts)
        self._rasterizer = SceneRasterizer(make_scene(LOG), "cpu")

    def render(self, state: SimState, camera_names: Sequence[str]) -> dict[str, Image]:
        poses = {key: as_sent(pose) for key, pose in state.poses.items()}
        images = {}
        for name in camera_names:
            mount = self._mounts[name]
            pose = se3.inverse(as_sent(state.world_from_rig @ mount.rig_from_camera))
            bent = not mount.camera.is_rectified
            camera = Lens(mount.camera).source if bent else mount.camera
            image = draw_image(self._rasterizer, camera, pose, poses, state.timestamp_us)
            images[name] = Lens(mount.camera).bend(image) if bent else image
        return images


def drive(renderer: SensorRenderer) -> tuple[Rollout, list[Mapping[str, Image]]]:
    setup = RolloutSetup(LOG, MOVING, MOTIONS["oncoming-a"], steps=20, traffic="replay")
    planner = Looker()
    return run_rollout(setup, planner, renderer), planner.seen


@pytest.mark.parametrize("image_format", ["png", "planar"])
def test_a_rollout_over_the_channel_is_the_one_in_process(
    image_format: Literal["png", "planar"],
) -> None:
    inside, wanted = drive(RoundedRenderer(MOUNTS))
    with serving() as server, SensorsimClient(f"127.0.0.1:{server.port}") as client:
        assert client.version == VERSION_ID
        renderer = SensorsimRenderer(client, SCENE, MOUNTS, image_format=image_format)
        outside, found = drive(renderer)
    np.testing.assert_array_equal(outside.ego, inside.ego)
    assert len(found) == len(wanted) == 4
    for there, here in zip(found, wanted, strict=True):
        assert list(there) == list(here) == ["front", "bent"]
        for name, image in there.items():
            np.testing.assert_array_equal(image, here[name])
            assert image.std() > 10
    # Without the rounding of poses, 8e-6 m here, a value rounds otherwise now and then, and a
    # Gaussian crosses the least opacity that is drawn.
    _, exact = drive(through_lenses(MOUNTS, lambda m: SceneRenderer(make_scene(LOG), m, "cpu")))
    apart = np.abs(exact[3]["front"].astype(int) - found[3]["front"])
    assert apart.max() <= 2


def test_jpeg_is_close() -> None:
    _, wanted = drive(RoundedRenderer(MOUNTS))
    with serving() as server, SensorsimClient(f"127.0.0.1:{server.port}") as client:
        _, found = drive(SensorsimRenderer(client, SCENE, MOUNTS, image_format="jpeg"))
    assert np.abs(found[0]["front"].astype(int) - wanted[0]["front"]).mean() < 10


@pytest.mark.parametrize("path", SENSORSIM_SERVICES)
def test_the_service_is_found_under_either_name(path: str) -> None:
    with serving(paths=[path]) as server, SensorsimClient(f"localhost:{server.port}") as client:
        assert client.scenes() == (SCENE,)
        assert [camera.logical_id for camera in client.cameras(SCENE)] == list(MOUNTS)


def test_a_server_of_another_name_is_refused() -> None:
    with (
        serving(paths=["other.Service"]) as server,
        pytest.raises(InputError, match="get_version: UNIMPLEMENTED"),
    ):
        SensorsimClient(f"localhost:{server.port}")


def test_unknown_scenes_are_named() -> None:
    with (
        serving() as server,
        SensorsimClient(f"localhost:{server.port}") as client,
        pytest.raises(InputError, match=f"scene other: is not served; choose one of {SCENE}"),
    ):
        SensorsimRenderer(client, "other", MOUNTS)


def call(port: int, method: str, data: bytes, **options: Any) -> bytes:
    """One call on a channel of its own."""
    unlimited = [("grpc.max_send_message_length", -1), ("grpc.max_receive_message_length", -1)]
    with grpc.insecure_channel(f"127.0.0.1:{port}", options=unlimited) as channel:
        found: bytes = channel.unary_unary(f"/{PATH}/{method}")(data, timeout=60, **options)
        return found


def status(port: int, method: str, data: bytes) -> tuple[grpc.StatusCode, str]:
    with pytest.raises(grpc.RpcError) as refused:
        call(port, method, data)
    return refused.value.code(), refused.value.details()


def alive(port: int) -> bool:
    return parse("VersionId", call(port, "get_version", b"")).version_id == VERSION_ID


def test_garbage_and_what_is_not_there_have_a_status_each() -> None:
    with serving() as server:
        code, details = status(server.port, "render_rgb", b"\xff" * 50)
        assert (
            code is grpc.StatusCode.INVALID_ARGUMENT
            and "cannot be read as RGBRenderRequest" in details
        )
        assert status(server.port, "shut_down", b"")[0] is grpc.StatusCode.UNIMPLEMENTED
        for method, words in (
            ("render_lidar", "recast does not render LiDAR"),
            ("get_loaded_scenes", "call get_available_scenes"),
            ("get_available_trajectories", "recast does not serve trajectories"),
        ):
            code, details = status(server.port, method, b"\xff")
            assert code is grpc.StatusCode.UNIMPLEMENTED
            assert method in details and words in details
        missing = message("RGBRenderRequest", scene_id="x").SerializeToString()
        assert status(server.port, "render_rgb", missing)[0] is grpc.StatusCode.NOT_FOUND
        assert alive(server.port)


def test_a_request_of_100_mb_is_refused() -> None:
    with serving() as server:
        code, _ = status(server.port, "render_rgb", bytes(100_000_000))
        assert code is grpc.StatusCode.RESOURCE_EXHAUSTED
        assert alive(server.port)


def test_bytes_that_are_no_http_do_not_matter() -> None:
    with serving() as server:
        for garbage in (b"GET / HTTP/1.1\r\n\r\n", bytes(range(256)) * 64, b""):
            with socket.create_connection(("127.0.0.1", server.port)) as raw:
                raw.sendall(garbage)
        assert alive(server.port)


class Waiting(ScenePainter):
    """Draws when it is told to."""

    def __init__(self) -> None:
        super().__init__(served(), "cpu")
        self.begun, self.go_on = Event(), Event()
        self.drawn = 0

    def draw(self, request: Any, wanted: Callable[[], bool] = lambda: True) -> Image:
        self.begun.set()
        assert self.go_on.wait(60)
        image = super().draw(request, wanted)
        self.drawn += 1
        return image


@contextmanager
def waiting(**options: Any) -> Iterator[tuple[Any, Waiting]]:
    painter = Waiting()
    try:
        with serving(painter=painter, **options) as server:
            yield server, painter
            painter.go_on.set()
    finally:
        painter.go_on.set()


def request(port: int) -> bytes:
    """A request that is drawn, as the client writes it."""
    sent: list[Any] = []

    class Recorder(SensorsimClient):
        def call(self, method: str, request: Any) -> Any:
            if method != "batch_render_rgb":
                return super().call(method, request)
            sent.append(request)
            raise InputError("", "", "", "")

    with Recorder(f"127.0.0.1:{port}") as client, pytest.raises(InputError):
        drive(SensorsimRenderer(client, SCENE, MOUNTS))
    data: bytes = sent[0].items[0].request.SerializeToString()
    return data


CALLER = """
import sys, grpc
channel = grpc.insecure_channel(sys.argv[1])
channel.unary_unary(sys.argv[2])(bytes.fromhex(sys.argv[3]))
"""


def test_a_client_that_dies_in_a_call_is_forgotten() -> None:
    with waiting(workers=2) as (server, painter):
        data = request(server.port)
        where, path = f"127.0.0.1:{server.port}", f"/{PATH}/render_rgb"
        with subprocess.Popen([sys.executable, "-c", CALLER, where, path, data.hex()]) as caller:
            assert painter.begun.wait(60)
            caller.kill()
        assert alive(server.port)  # while the other worker still waits for its turn
        painter.begun.clear()
        with ThreadPoolExecutor(1) as pool:
            answer = pool.submit(call, server.port, "render_rgb", data)
            assert painter.begun.wait(60)
            painter.go_on.set()
            assert parse("RGBRenderReturn", answer.result()).image_bytes
    assert painter.drawn == 1  # nothing was drawn for the one that died


def test_more_calls_than_the_queue_holds_are_refused() -> None:
    with waiting(workers=1, queue=1) as (server, painter):
        data = request(server.port)
        with grpc.insecure_channel(f"127.0.0.1:{server.port}") as channel:
            ask = channel.unary_unary(f"/{PATH}/render_rgb")
            first = ask.future(data)
            assert painter.begun.wait(60)
            second = ask.future(data)
            # The server counts calls in the order of their arrival on one channel.
            with pytest.raises(grpc.RpcError) as refused:
                ask(data, timeout=60)
            assert refused.value.code() is grpc.StatusCode.RESOURCE_EXHAUSTED
            painter.go_on.set()
            assert first.result() == second.result()


def test_a_deadline_ends_the_call_with_one_line() -> None:
    with waiting() as (server, painter):
        with SensorsimClient(f"127.0.0.1:{server.port}") as client:
            renderer = SensorsimRenderer(client, SCENE, MOUNTS)
            client._deadline = 0.5  # for the call that is never answered
            with pytest.raises(InputError, match="batch_render_rgb: DEADLINE_EXCEEDED"):
                drive(renderer)
        painter.go_on.set()


def test_a_fault_of_the_server_is_told_and_logged(caplog: pytest.LogCaptureFixture) -> None:
    class Broken(ScenePainter):
        def draw(self, request: Any, wanted: Callable[[], bool] = lambda: True) -> Image:
            raise ZeroDivisionError("a secret path")

    with serving(painter=Broken(served(), "cpu")) as server:
        code, details = status(server.port, "render_rgb", request(server.port))
        assert code is grpc.StatusCode.INTERNAL
        assert details == "render_rgb failed; the server's log says why"
        assert alive(server.port)
    assert "a secret path" in caplog.text


@contextmanager
def trickle(port: int, size: int) -> Iterator[int]:
    """A port that leads to another one, and hands back `size` bytes each 10 ms."""
    with socket.create_server(("127.0.0.1", 0)) as listener:
        stop = Event()

        def pump(source: socket.socket, target: socket.socket, most: int, pause: float) -> None:
            try:
                while data := source.recv(most):
                    target.sendall(data)
                    if stop.wait(pause):
                        return
            except OSError:
                return

        near_far: list[socket.socket] = []

        def accept() -> None:
            near, _ = listener.accept()
            far = socket.create_connection(("127.0.0.1", port))
            far.setsockopt(socket.SOL_SOCKET, socket.SO_RCVBUF, 4096)
            near_far.extend((near, far))
            Thread(target=pump, args=(near, far, 65536, 0.0), daemon=True).start()
            pump(far, near, size, 0.01)

        thread = Thread(target=accept, daemon=True)
        thread.start()
        try:
            yield listener.getsockname()[1]
        finally:
            stop.set()
            for one in near_far:
                one.close()
            thread.join(60)


def test_a_slow_reader_holds_up_nobody_and_gets_its_image() -> None:
    with serving(workers=1) as server:
        data = request(server.port)
        wanted = call(server.port, "render_rgb", data)
        with (
            trickle(server.port, 200) as slow,
            grpc.insecure_channel(f"127.0.0.1:{slow}") as channel,
        ):
            answer = channel.unary_unary(f"/{PATH}/render_rgb").future(data, timeout=60)
            for _ in range(3):
                assert call(server.port, "render_rgb", data) == wanted
            assert answer.result() == wanted


def test_a_server_that_is_killed_and_comes_back_is_found_again() -> None:
    with serving() as server:
        port = server.port
        client = SensorsimClient(f"127.0.0.1:{port}")
        renderer = SensorsimRenderer(client, SCENE, MOUNTS)
        wanted = drive(renderer)[1]
    with client:
        with pausing(client, QUICK), pytest.raises(InputError, match="UNAVAILABLE"):
            drive(renderer)
        back = Event()

        def come_back() -> None:
            with serving(port=port):
                assert back.wait(60)

        thread = Thread(target=come_back)
        thread.start()
        try:
            with pausing(client, 60 * [0.5]):  # the server may take its time to start
                found = drive(renderer)[1]
        finally:
            back.set()
            thread.join(60)
    for there, here in zip(found, wanted, strict=True):
        np.testing.assert_array_equal(there["front"], here["front"])


def test_there_is_no_server() -> None:
    with socket.create_server(("127.0.0.1", 0)) as taken:
        port = taken.getsockname()[1]
    with pytest.raises(InputError, match="get_version: UNAVAILABLE"):
        SensorsimClient(f"127.0.0.1:{port}", pauses=QUICK)


def test_a_port_that_is_taken_is_refused() -> None:
    with (
        serving() as server,
        pytest.raises(
            InputError, match="is in use or is not an address of this machine; choose a free port"
        ),
        serving(port=server.port),
    ):
        pass


def test_many_clients_at_once_get_their_own_images() -> None:
    with serving() as server:
        data = request(server.port)
        requests = []
        for index in range(12):
            one = parse("RGBRenderRequest", data)
            one.sensor_pose.start_pose.vec.x += 0.3 * index
            one.sensor_pose.end_pose.vec.x += 0.3 * index
            requests.append(one.SerializeToString())
        wanted = [call(server.port, "render_rgb", one) for one in requests]
        assert len(set(wanted)) == len(wanted)
        with ThreadPoolExecutor(12) as pool:
            found = pool.map(lambda one: call(server.port, "render_rgb", one), 3 * requests)
            assert list(found) == 3 * wanted


def replying(reply: Any) -> Any:
    """A server whose batches are answered with `reply`."""
    server = grpc.server(ThreadPoolExecutor(1), options=CHANNEL_OPTIONS)
    scenes = message("AvailableScenesReturn", scene_ids=["*"])
    replies = {"get_version": b"", "get_available_scenes": scenes.SerializeToString()}
    replies["batch_render_rgb"] = reply if isinstance(reply, bytes) else reply.SerializeToString()
    handlers = {
        method: grpc.unary_unary_rpc_method_handler(lambda _, __, data=data: data)
        for method, data in replies.items()
    }
    server.add_generic_rpc_handlers((grpc.method_handlers_generic_handler(PATH, handlers),))
    return server


def result(name: str, data: bytes = b"", **fields: Any) -> Any:
    image = message("RGBRenderReturn", image_bytes=data)
    return message(
        "BatchResult", **{"camera_name": name, "result": image, "success": True, **fields}
    )


@pytest.mark.parametrize(
    ("reply", "problem"),
    [
        (b"\xff\xff\xff", "is not a BatchRGBRenderReturn"),
        ([], "the reply has nothing"),
        ([result("front"), result("front")], "the reply has front, front"),
        ([result("front"), result("bent", success=False, error_message="no")], "bent: failed: no"),
        ([result("front", b"\x89PNG"), result("bent")], "front: image: cannot be decoded"),
    ],
)
def test_replies_that_are_none_are_named(reply: Any, problem: str) -> None:
    if isinstance(reply, list):
        reply = message("BatchRGBRenderReturn", items=reply)
    server = replying(reply)
    port = server.add_insecure_port("127.0.0.1:0")
    server.start()
    try:
        with (
            SensorsimClient(f"127.0.0.1:{port}") as client,
            pytest.raises(InputError, match=problem),
        ):
            drive(SensorsimRenderer(client, "any", MOUNTS))
    finally:
        server.stop(None).wait()
