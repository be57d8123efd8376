"""What a worker does with the tasks of a grid."""

from __future__ import annotations

import logging
import shutil
import time
from collections.abc import Callable
from contextlib import suppress
from pathlib import Path

from rich.console import Console

from recast import storage
from recast.errors import InputError
from recast.pipeline.bench.scene_run import SceneRun
from recast.pipeline.bench.score import score_scene
from recast.pipeline.bench.settings import SCENES_FOLDER, BenchSettings
from recast.pipeline.bench.tasks import (
    Outcome,
    RolloutTask,
    RolloutTimes,
    SceneTask,
    ScoreTask,
    Task,
)
from recast.pipeline.drive import drive_log
from recast.pipeline.fingerprint import folder_hash
from recast.pipeline.rollouts import is_failure, write_failure
from recast.pipeline.run_folder import RunFolder
from recast.pipeline.sources import Sources
from recast.simulation import RolloutFailure, Timings, error_fields
from recast.synthetic import make_world

_LOG = logging.getLogger(__name__)

LOG_FOLDER, RUN_FOLDER = "log", "run"
FAILURE_FILE = "failure.json"
"""What ended a scene's last try, with its traceback; gone when the scene is made."""
_UNSAVED = "unsaved"
"""Instead of the hash of a rollout that never began; a further try begins it again."""


def start_worker(
    number: int, out: Path, settings: BenchSettings, retry_failures: bool
) -> Callable[[Task], Outcome]:
    """A worker of a crew; `number` makes no difference."""
    del number
    from recast.splats import set_threads

    set_threads(1)
    return BenchWorker(out, settings, retry_failures)


class BenchWorker:
    """Does tasks one after the other, and keeps the scene of the last open.

    Whatever a task raises is its outcome: no scene and no planner ends the grid.

    Args:
        out: folder of the grid.
        settings: of the grid.
        retry_failures: run rollouts again that failed in an earlier try.
    """

    def __init__(self, out: Path, settings: BenchSettings, retry_failures: bool) -> None:
        self._out, self._settings, self._retry = out, settings, retry_failures
        self._sources = Sources.of(settings.run)  # before anything of them is loaded
        self._open: tuple[str, SceneRun] | None = None

    def __call__(self, task: Task) -> Outcome:
        """The task's outcome."""
        try:
            if isinstance(task, SceneTask):
                return self._make_scene(task)
            run = self._scene_run(task.scene.id)
            if isinstance(task, RolloutTask):
                return self._make_rollout(task, run)
            assert isinstance(task, ScoreTask)
            return Outcome(rows=score_scene(run, task))
        except Exception as error:
            _LOG.warning("%s of %s failed", type(task).__name__, task.scene.id, exc_info=True)
            fault = error_fields(error)
            with suppress(InputError):  # the disk may be what failed
                storage.write_json(self._path(task.scene.id) / FAILURE_FILE, fault)
            return Outcome(fault["error"], fault["reason"])

    def _path(self, scene_id: str) -> Path:
        return self._out / SCENES_FOLDER / scene_id

    def _make_scene(self, task: SceneTask) -> Outcome:
        scene, path, settings = task.scene, self._path(task.scene.id), self._settings
        if scene.world is not None and scene.seed is not None:
            size = settings.drive
            world = make_world(scene.world, scene.seed, size.seconds)
            cameras, track = settings.run.scene.cameras, world.target
            log, image_size = path / LOG_FOLDER, (size.width, size.height)
            drive_log(world, log, image_size, cameras, 1, Console(quiet=True))
        else:
            assert scene.log is not None and scene.track is not None
            log, track = scene.log, scene.track
        config = settings.run_of(track).resolved()
        RunFolder.create_or_resume(path / RUN_FOLDER, config, str(log), folder_hash(log))
        self._scene_run(scene.id)
        with storage.disk_errors(path):
            (path / FAILURE_FILE).unlink(missing_ok=True)
        return Outcome()

    def _scene_run(self, scene_id: str) -> SceneRun:
        if self._open is None or self._open[0] != scene_id:
            if self._open is not None:
                self._open[1].close()
                self._open = None
            self._open = scene_id, SceneRun(self._path(scene_id) / RUN_FOLDER, self._sources)
        return self._open[1]

    def _make_rollout(self, task: RolloutTask, run: SceneRun) -> Outcome:
        folder = run.rollout_folder(task.motion, task.method)
        if self._retry and is_failure(folder):
            shutil.rmtree(folder)
        timings, began = Timings(), time.perf_counter()
        try:
            made = run.make_rollout(task.motion, task.method, timings)
        except Exception as error:
            # before it began: its renderer or planner cannot be loaded
            _LOG.warning("rollout %s cannot begin", task.key, exc_info=True)
            shutil.rmtree(folder, ignore_errors=True)
            write_failure(_failure(task, run, error), folder)
            return Outcome(hash=_UNSAVED)
        if timings.plan == 0.0:  # found finished, or refused before the first plan
            return Outcome(hash=made)
        total = time.perf_counter() - began
        times = RolloutTimes(timings.render, timings.plan, timings.control, total, timings.frames)
        return Outcome(hash=made, times=times)


def _failure(task: RolloutTask, run: SceneRun, error: Exception) -> RolloutFailure:
    motion = run.job.config.motion(task.motion)
    return RolloutFailure(
        name=f"{task.motion}-{task.method}",
        method=task.method,
        track_id=run.job.config.track,
        motion=motion.name,
        setting=motion.setting,
        planner=run.job.planner.name,
        **error_fields(error),
    )
