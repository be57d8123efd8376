"""The tasks of a scene-level evaluation, their order, and the workers that do them."""

from __future__ import annotations

from collections import deque
from dataclasses import asdict, dataclass

from recast.core import Artefact, Store
from recast.core.remote import Fetch
from recast.metrics.scene_level.scores import Networks
from recast.studies.scene_level.request import LevelSettings
from recast.studies.scene_level.scene import FEATURES, REFERENCES, REPLAY, LevelScene
from recast.studies.scene_run import GridTask, RolloutTimes, SceneOutcome, SceneRun
from recast.studies.schedule import BenchWorker


@dataclass(frozen=True)
class DriveTask(GridTask):
    """From nothing to a scene's streets, vehicles, drives, and the images that count."""


@dataclass(frozen=True)
class MeasureTask(GridTask):
    """Features of an arm's images, of the logged ones, or of the control's."""

    what: str = ""


class LevelTasks:
    """The tasks that are ready, and what came of them.

    Attributes:
        used: references of artefacts by scene and use.
        failures: error and its reason, by scene, and by the arm where one failed alone.
    """

    def __init__(self, settings: LevelSettings) -> None:
        self._settings = settings
        grid = settings.grid
        self._ready: deque[GridTask] = deque(DriveTask(scene) for scene in grid.scenes)
        self.used: dict[str, dict[str, str]] = {scene.id: {} for scene in grid.scenes}
        self.failures: dict[tuple[str, str], str] = {}
        self.done, self.total = 0, len(grid.scenes) * (1 + len(measured(settings)))

    def take(self) -> GridTask | None:
        """The next task, or None where there is none now."""
        return self._ready.popleft() if self._ready else None

    def note(self, task: GridTask, outcome: SceneOutcome) -> None:
        """A task is done: what it makes possible becomes ready."""
        names = measured(self._settings)
        self.done += 1
        self.used[task.scene.id] |= outcome.used
        if isinstance(task, DriveTask):
            if outcome.error is None:
                self._ready.extend(MeasureTask(task.scene, outcome.log, {}, n) for n in names)
            else:
                self.done += len(names)
        if outcome.error is not None:
            what = task.what if isinstance(task, MeasureTask) else ""
            self.failures[task.scene.id, what] = f"{outcome.error}: {outcome.reason}"

    def needed(self, task: GridTask) -> tuple[str, ...]:
        """References of what the scene of a task has so far, but for features."""
        used = self.used[task.scene.id]
        return tuple(dict.fromkeys(v for use, v in used.items() if not _is_features(use)))


def measured(settings: LevelSettings) -> tuple[str, ...]:
    """What the networks look at in each scene: the arms, the logged images, and the control."""
    arms = settings.grid.run.arms
    control = (REPLAY,) if any(arm.reconstructs for arm in arms) else ()
    return (*(arm.name for arm in arms), REFERENCES, *control)


class LevelWorker(BenchWorker):
    """Does the tasks of a scene-level evaluation, see `BenchWorker`; networks are loaded once."""

    def __init__(self, store: Store, settings: LevelSettings, fetch: Fetch | None) -> None:
        super().__init__(store, settings.grid, False, fetch)
        self._level = settings
        self._loaded: Networks | None = None
        self._opened: tuple[SceneRun, LevelScene] | None = None

    def _do(self, task: GridTask, run: SceneRun) -> RolloutTimes | None:
        if self._opened is None or self._opened[0] is not run:
            self._opened = run, LevelScene(run, self._level, self._networks)
        scene = self._opened[1]
        for use in [use for use in run.artefacts.used if _is_features(use)]:
            del run.artefacts.used[use]  # of the tasks before
        if isinstance(task, MeasureTask):
            scene.measured(task.what)
        else:
            scene.prepare()
        return None

    def _is_new(self, task: GridTask, artefact: Artefact) -> bool:
        return True

    def _networks(self) -> Networks:
        if self._loaded is None:
            self._loaded = Networks(**asdict(self._level.networks))
        return self._loaded


def _is_features(use: str) -> bool:
    return use.startswith(f"{FEATURES}/")
