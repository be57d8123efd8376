"""`recast serve`: scenes and runs under the names that other simulators call them by."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from contextlib import ExitStack, suppress
from dataclasses import dataclass
from pathlib import Path
from threading import Event

import numpy as np
from rich.console import Console

from recast.arrays import Array
from recast.cameras import CameraMount
from recast.core.errors import InputError, require_range
from recast.core.web_server import WebServer
from recast.core.workers import use_threads
from recast.geometry import se3
from recast.logs import DrivingLog, load_log
from recast.runs.run_folder import RUN_FILE
from recast.runs.view import run_inputs
from recast.scene import StreetScene, load_scene
from recast.scene.exchange import given_placement
from recast.scene.store import SCENE_FILE
from recast_bridges.neuroncap import NcapService, ncap_app
from recast_bridges.rendering import ScenePainter, ServedScene, Unnamed


@dataclass(frozen=True)
class ServeRequest:
    """What `recast serve` is asked for; its help says what each is."""

    scenes: Sequence[str]
    logs: Sequence[str] = ()
    arm: str | None = None
    host: str = "127.0.0.1"
    port: int = 50051
    unnamed: Unnamed = "hidden"
    world_from_local: Path | None = None
    ftheta_centre: float = 0.5
    paths: Sequence[str] = ()
    workers: int = 8
    queue: int = 256
    threads: int = 0
    device: str = "auto"
    names: Sequence[str] = ()


def serve_sensorsim(request: ServeRequest, console: Console) -> None:
    """Serve until interrupted. Raises InputError: the extra is missing, a folder or number is
    wrong, or the port is taken."""
    try:
        import grpc  # noqa: F401
    except ImportError:
        mend = "pip install 'recast-sim[alpasim]'"
        raise InputError("grpcio", "module", "is not installed", mend) from None
    from recast_bridges.alpasim.messages import SENSORSIM_SERVICES
    from recast_bridges.alpasim.server import SensorsimServer, SensorsimService

    require_range(0, 65535, port=request.port)
    require_range(1, 1024, workers=request.workers)
    require_range(0, 1 << 20, queue=request.queue)
    require_range(-1.0, 1.0, ftheta_centre=request.ftheta_centre)
    painter = _painter(request)
    server = SensorsimServer(
        SensorsimService(painter, request.ftheta_centre),
        request.host,
        request.port,
        workers=request.workers,
        queue=request.queue,
        paths=tuple(dict.fromkeys((*SENSORSIM_SERVICES, *request.paths))),
    )
    with server:
        for name, served in painter.scenes.items():
            _say(console, f"scene {name}: cameras {', '.join(served.cameras)}")
        _say(console, f"serving sensorsim at {request.host}:{server.port}; Ctrl+C ends it")
        with suppress(KeyboardInterrupt):
            server.wait()


def serve_neuroncap(request: ServeRequest, console: Console) -> None:
    """Serve until interrupted: the first scene at the port, each further one at the next. Raises
    InputError: a folder or number is wrong, or a port is taken."""
    painter = _painter(request, dataset_frame=True)
    names = [name.lower() for name in request.names]
    require_range(0, 65536 - len(painter.scenes), port=request.port)
    with ExitStack() as opened:
        for number, (name, served) in enumerate(painter.scenes.items()):
            port = request.port and request.port + number
            server = WebServer(ncap_app(NcapService(painter, name)), request.host, port, names)
            opened.enter_context(server.in_background())
            _say(console, f"scene {name}: cameras {', '.join(served.cameras)}")
            _say(console, f"serving neuroncap at {request.host}:{server.port}; Ctrl+C ends it")
        with suppress(KeyboardInterrupt):
            Event().wait()


def _say(console: Console, line: str) -> None:
    console.print(line, markup=False, highlight=False, soft_wrap=True)


def _painter(request: ServeRequest, dataset_frame: bool = False) -> ScenePainter:
    require_range(0, 1024, threads=request.threads)
    use_threads(request.threads)
    scenes = served_scenes(request, dataset_frame)
    return ScenePainter(scenes, request.device, request.unnamed)


def served_scenes(request: ServeRequest, dataset_frame: bool = False) -> dict[str, ServedScene]:
    """The scenes of a request by id.

    Args:
        dataset_frame: whether poses on the wire are in the coordinates of the dataset, unless the
            request says otherwise; else in the world of the log.

    Raises:
        InputError: no scene, a folder is neither scene nor run, the log of a scene is not named,
            a run has no such arm, or two scenes have one id.
    """
    if not request.scenes:
        raise InputError("SCENE", "folder", "is missing", "name a scene folder or a run folder")
    logs = {log.name: log for log in map(load_log, request.logs)}
    given: Array | None = None
    if request.world_from_local is not None:
        given = given_placement(request.world_from_local).world_from_scene
    found: dict[str, ServedScene] = {}
    for word in request.scenes:
        for name, scene, log in _scenes_of(word, logs, request.arm):
            if name in found:
                mend = "give one of the scenes another id: ID=FOLDER"
                raise InputError("SCENE", name, "is the id of two scenes", mend)
            cameras = {
                key: CameraMount(stream.camera, stream.rig_from_camera)
                for key, stream in log.cameras.items()
            }
            offset = -log.world_offset if dataset_frame else np.zeros(3)
            world = se3.from_rotation_translation(np.eye(3), offset) if given is None else given
            start = int(log.world_from_rig.timestamps_us[0])
            found[name] = ServedScene(scene, cameras, world, start)
    return found


def _scenes_of(
    word: str, logs: dict[str, DrivingLog], arm: str | None
) -> Iterator[tuple[str, StreetScene, DrivingLog]]:
    """Id, scene and log of what a word names."""
    name, given, folder = word.partition("=")
    if not given or Path(word).exists():
        name, folder = "", word
    path = Path(folder)
    if (path / SCENE_FILE).is_file():
        scene = load_scene(path)
        if scene.log_name not in logs:
            problem = f"needs the log {scene.log_name}, which is not given"
            raise InputError(path, "scene", problem, "give the log's folder with --log")
        yield name or scene.log_name, scene, logs[scene.log_name]
        return
    if not (path / RUN_FILE).is_file():
        mend = "name folders of recast scene train, recast scene import or recast run"
        raise InputError(path, "SCENE", "is not a folder of a scene or of a run", mend)
    inputs = run_inputs(path)
    assert inputs.log is not None  # every run has one
    arms = {key: scene for key, scene in inputs.scenes.items() if scene is not None}
    if arm is not None and arm not in arms:
        there = ", ".join(arms) or "none"
        raise InputError(path, f"arm {arm}", "has no scene in this run", f"choose one of {there}")
    name = name or inputs.log.name
    for key, street in arms.items():
        if arm is None:
            yield f"{name}-{key}", street, inputs.log
        elif key == arm:
            yield name, street, inputs.log
