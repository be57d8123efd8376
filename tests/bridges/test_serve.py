"""`recast serve`: scenes by id, refusals in one line, and the commands themselves."""

from __future__ import annotations

import os
import signal
import subprocess
import sys
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from recast.cli.main import main
from recast.logs import DrivingLog
from recast.runs.run_folder import RUN_FILE
from recast.scene import StreetScene
from recast.scene.store import save_scene
from recast.viewer import ViewInputs
from recast_bridges import serve
from recast_bridges.json_service import JsonService
from recast_bridges.serve import ServeRequest, served_scenes
from support.moments import forked
from support.tiny_served import make_log, make_scene

pytest.importorskip("grpc")


@pytest.fixture(scope="module")
def street(tiny_log: DrivingLog) -> StreetScene:
    return replace(make_scene(make_log()), log_name=tiny_log.name)


@pytest.fixture(scope="module")
def folder(street: StreetScene, tmp_path_factory: pytest.TempPathFactory) -> Path:
    found = tmp_path_factory.mktemp("served") / "scene"
    save_scene(street, found)
    return found


def test_a_scene_has_the_cameras_and_the_name_of_its_log(
    folder: Path, tiny_log_folder: Path, tiny_log: DrivingLog
) -> None:
    words = (str(folder), f"another={folder}")
    found = served_scenes(ServeRequest(words, (str(tiny_log_folder),)))
    assert list(found) == [tiny_log.name, "another"]
    served = found["another"]
    assert list(served.cameras) == list(tiny_log.cameras)
    for name, stream in tiny_log.cameras.items():
        assert served.cameras[name].camera == stream.camera
        np.testing.assert_array_equal(served.cameras[name].rig_from_camera, stream.rig_from_camera)
    np.testing.assert_array_equal(served.world_from_local, np.eye(4))


def test_requests_may_have_other_coordinates(
    folder: Path, tiny_log_folder: Path, tmp_path: Path
) -> None:
    path = tmp_path / "offset.txt"
    path.write_text("10 20 -3")
    request = ServeRequest((str(folder),), (str(tiny_log_folder),), world_from_local=path)
    (served,) = served_scenes(request).values()
    np.testing.assert_array_equal(served.world_from_local[:3, 3], [10.0, 20.0, -3.0])


def test_a_run_serves_its_arms(
    street: StreetScene, tiny_log: DrivingLog, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    (tmp_path / RUN_FILE).write_text("{}")
    streets = {"native": street, "replaced": street, "oracle": None}

    def inputs(path: Path) -> Any:
        assert path == tmp_path
        return ViewInputs("a run", streets, {}, tiny_log)

    monkeypatch.setattr(serve, "run_inputs", inputs)
    found = served_scenes(ServeRequest((str(tmp_path),)))
    assert list(found) == [f"{tiny_log.name}-native", f"{tiny_log.name}-replaced"]
    assert list(served_scenes(ServeRequest((str(tmp_path),), arm="replaced"))) == [tiny_log.name]
    assert list(served_scenes(ServeRequest((f"x={tmp_path}",), arm="native"))) == ["x"]
    with pytest.raises(Exception, match="arm oracle: has no scene in this run; choose one of nat"):
        served_scenes(ServeRequest((str(tmp_path),), arm="oracle"))


def test_what_cannot_be_served_is_one_line(
    folder: Path, tiny_log_folder: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    log = ["--log", str(tiny_log_folder)]
    for words, problem in (
        ([str(folder)], "which is not given; give the log's folder with --log"),
        ([str(tiny_log_folder)], "is not a folder of a scene or of a run"),
        ([str(folder), str(folder), *log], "is the id of two scenes"),
        ([str(folder), *log, "--port", "99999"], "--port: value: is 99999; give 0 to 65535"),
        ([str(folder), *log, "--workers", "0"], "--workers: value: is 0"),
        ([str(folder), *log, "--ftheta-centre", "9"], "--ftheta-centre: value: is 9"),
        ([str(folder), *log, "--host", "no.such.host.invalid"], "--port: no.such"),
        ([], "SCENE: folder: is missing"),
    ):
        assert main(["serve", "sensorsim", *words]) == 2
        said = capsys.readouterr().err
        assert said.count("\n") == 1 and problem in said, said
        assert "recast docs howto/alpasim" in said


def test_without_the_extra_it_says_how_to_get_it(
    folder: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    monkeypatch.setitem(sys.modules, "grpc", None)
    assert main(["serve", "sensorsim", str(folder)]) == 2
    assert "pip install 'recast-sim[alpasim]'" in capsys.readouterr().err


@contextmanager
def command(*words: str) -> Iterator[Callable[[], str]]:
    """The command; gives what reads its next line. It ends when it is interrupted."""
    # A child of a job in the background ignores interrupts, as the job does.
    code = (
        "import signal, sys; signal.signal(signal.SIGINT, signal.default_int_handler); "
        "from recast.cli.main import main; sys.exit(main())"
    )
    line = [sys.executable, "-uc", code, "serve", *words]
    line += ["--port", "0", "--threads", "1", "--device", "cpu"]
    with subprocess.Popen(line, stdout=subprocess.PIPE, text=True) as server:
        try:
            assert server.stdout is not None
            yield server.stdout.readline
            server.send_signal(signal.SIGINT)
            assert server.wait(120) == 0
        finally:
            server.kill()


@contextmanager
def in_a_copy(*words: str) -> Iterator[Callable[[], str]]:
    """As `command`, in a copy of this process, which has all modules already."""
    receiving, sending = os.pipe()

    def work() -> None:
        os.dup2(sending, 1)
        sys.stdout = os.fdopen(1, "w", buffering=1)
        signal.signal(signal.SIGINT, signal.default_int_handler)
        assert main(["serve", *words, "--port", "0", "--threads", "1", "--device", "cpu"]) == 0

    child = forked(work)
    os.close(sending)
    try:
        with os.fdopen(receiving) as stream:
            yield stream.readline
        os.kill(child, signal.SIGINT)
        assert os.waitstatus_to_exitcode(os.waitpid(child, 0)[1]) == 0
    except BaseException:
        os.kill(child, signal.SIGKILL)
        raise


def test_the_command_serves_until_it_is_interrupted(
    folder: Path, tiny_log_folder: Path, tiny_log: DrivingLog
) -> None:
    from recast_bridges.alpasim import SensorsimClient

    with command("sensorsim", str(folder), "--log", str(tiny_log_folder)) as line:
        assert line() == f"scene {tiny_log.name}: cameras {', '.join(tiny_log.cameras)}\n"
        place = line().split(";")[0].removeprefix("serving sensorsim at ")
        with SensorsimClient(place) as client:
            assert client.scenes() == (tiny_log.name,)


def test_neuroncap_has_a_port_for_each_scene(
    folder: Path, tiny_log_folder: Path, tiny_log: DrivingLog
) -> None:
    words = [f"a={folder}", f"b={folder}", "--log", str(tiny_log_folder)]
    with in_a_copy("neuroncap", *words) as line:
        for name in ("a", "b"):
            assert line() == f"scene {name}: cameras {', '.join(tiny_log.cameras)}\n"
            place = line().split(";")[0].removeprefix("serving neuroncap at ")
            service = JsonService.at(place, "renderer")
            start = service.ask("GET", "/start_time", seconds=60, most_bytes=100)
            assert start == int(tiny_log.world_from_rig.timestamps_us[0])


def test_neuroncap_speaks_in_the_coordinates_of_the_dataset(
    folder: Path, tiny_log: DrivingLog, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    there = replace(tiny_log, world_offset=np.array([100.0, 200.0, 3.0]))
    monkeypatch.setattr(serve, "load_log", lambda _: there)
    (served,) = served_scenes(ServeRequest((str(folder),), ("log",)), dataset_frame=True).values()
    np.testing.assert_array_equal(served.world_from_local[:3, 3], [-100.0, -200.0, -3.0])
    path = tmp_path / "offset.txt"
    path.write_text("10 20 -3")
    request = ServeRequest((str(folder),), ("log",), world_from_local=path)
    (served,) = served_scenes(request, dataset_frame=True).values()
    np.testing.assert_array_equal(served.world_from_local[:3, 3], [10.0, 20.0, -3.0])
