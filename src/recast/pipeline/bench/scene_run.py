"""One scene of a grid: its log, and the artefacts of an ordinary run on it."""

from __future__ import annotations

from pathlib import Path

from rich.console import Console

from recast.core import Artefact, Store, folder_hash
from recast.pipeline.artefacts import Artefacts
from recast.pipeline.bench.scenes import BenchScene
from recast.pipeline.bench.settings import BenchSettings
from recast.pipeline.drive import drive_log
from recast.pipeline.making import copy_folder
from recast.pipeline.source_log import SourceLog
from recast.pipeline.sources import RECIPES, Sources
from recast.synthetic import World, make_world, world_metadata

LOG_FOLDER = "log"


def log_artefact(store: Store, scene: BenchScene, settings: BenchSettings) -> Artefact:
    """The log of a synthetic scene; or a copy of a recorded one, to travel to other machines.

    Raises:
        InputError: see `make_world` and `drive_log`.
    """
    if scene.log is not None:
        path = scene.log
        return store.make(
            "logs", {"content": folder_hash(path)},
            lambda out: copy_folder(path, out / LOG_FOLDER), name=scene.id,
        )  # fmt: skip
    assert scene.world is not None and scene.seed is not None
    size, cameras = settings.drive, settings.run.scene.cameras
    world = make_world(scene.world, scene.seed, size.seconds)
    inputs = {
        "world": world_metadata(world), "image_size": [size.width, size.height],
        "cameras": list(cameras), "recipe": RECIPES["log"],
    }  # fmt: skip
    return store.make(
        "logs", inputs,
        lambda out: _drive(world, out / LOG_FOLDER, settings), name=scene.id,
    )  # fmt: skip


def _drive(world: World, path: Path, settings: BenchSettings) -> None:
    size = settings.drive
    image_size, cameras = (size.width, size.height), settings.run.scene.cameras
    drive_log(world, path, image_size, cameras, 1, Console(quiet=True))


class SceneRun:
    """The artefacts of a scene; close it.

    Args:
        store: of the artefacts.
        scene: which.
        settings: of the grid.
        log: the artefact of its log; None for one in a folder of its own.
        known: see `Sources.of`.

    Raises:
        InputError: a faulty log, or a camera that a planner wants and the log lacks.
    """

    def __init__(
        self,
        store: Store,
        scene: BenchScene,
        settings: BenchSettings,
        log: Artefact | None,
        known: Sources | None = None,
    ) -> None:
        self.log = log
        path = scene.log if log is None else log.path / LOG_FOLDER
        assert path is not None  # synthetic logs are artefacts
        source = SourceLog.open(path)
        track = source.log.metadata["target"] if scene.track is None else scene.track
        config = settings.run_of(track)
        sources = Sources.of(config, scene.id, known)
        console = Console(quiet=True)
        self.artefacts = Artefacts(store, source, config, sources, console, scene.id, 1)
        if log is not None:
            self.artefacts.used["log"] = log

    def prepare(self) -> None:
        """Make streets and vehicles, as far as anything is rendered.

        A planner that reads states, without films, needs none of them.
        """
        for planner in self.artefacts.config.planners:
            self.artefacts.mounts(planner)
        for arm in self.artefacts.arms.values():
            self.artefacts.prepare(arm, further=False)

    @property
    def path(self) -> Path:
        """The folder of the log."""
        return self.artefacts.source.path

    def used(self) -> dict[str, str]:
        """References by use."""
        return {use: one.reference for use, one in self.artefacts.used.items()}
