"""What this process does for each scene of a grid: its run folder, its scores, its failures."""

from __future__ import annotations

from collections.abc import Mapping
from contextlib import suppress
from pathlib import Path

from recast import storage
from recast.core import Store
from recast.errors import InputError
from recast.evaluation.grid_row import GridRow
from recast.pipeline.bench.scene_run import LOG_FOLDER
from recast.pipeline.bench.score import scene_rows
from recast.pipeline.bench.settings import SCENES_FOLDER, BenchSettings
from recast.pipeline.bench.tasks import Outcome, RolloutTask, Task
from recast.pipeline.layout import METRICS_FILE
from recast.pipeline.results_files import read_metrics
from recast.pipeline.run_folder import RunFolder
from recast.pipeline.scores import write_metrics
from recast.pipeline.source_log import SourceLog

FAILURE_FILE = "failure.json"
"""What ended a scene's last try, with its traceback; gone when the scene is made."""
SCENE_PARTS = ("scene/", "evaluation/", "registered/", "actor/")


class SceneDesk:
    """Writes OUT/scenes/ID of every scene.

    Args:
        settings: of the grid.
        out: folder of the grid.
        store: of the artefacts.
        names: planners' names in results, by the word that asks for them.
    """

    def __init__(
        self, settings: BenchSettings, out: Path, store: Store, names: Mapping[str, str]
    ) -> None:
        self._settings, self._out, self._store, self._names = settings, out, store, names
        self._seconds: dict[str, dict[str, float]] = {}

    def note(self, task: Task, outcome: Outcome) -> None:
        """Keep the traceback of a task that failed; forget that of an earlier try."""
        path = self._out / SCENES_FOLDER / f"{task.scene.id}.{FAILURE_FILE}"
        with suppress(InputError):  # the disk may be what failed
            if outcome.error is not None:
                fault = {"error": outcome.error, "reason": outcome.reason}
                storage.write_json(path, {**fault, "traceback": outcome.traceback})
            elif not isinstance(task, RolloutTask):
                path.unlink(missing_ok=True)

    def score(
        self, scene_id: str, used: dict[str, str], log: str | None, errors: dict[str, Outcome]
    ) -> list[GridRow]:
        """Write the run folder of a scene whose rollouts are all made; return its rows."""
        scene = next(one for one in self._settings.scenes if one.id == scene_id)
        artefacts = {use: self._store.open(name) for use, name in used.items() if use != "log"}
        path = scene.log if log is None else self._store.open(log).path / LOG_FOLDER
        assert path is not None
        source = SourceLog.open(path)
        track = source.log.metadata["target"] if scene.track is None else scene.track
        config = self._settings.run_of(track)
        out = self._out / SCENES_FOLDER / scene.id
        folder = RunFolder.create_or_resume(
            out, config.resolved(), path, source.hash, str(self._store.root)
        )
        kept = {} if log is None else {"log": self._store.open(log)}
        folder.refer(self._store, {**kept, **artefacts}, whole=True)
        write_metrics(out / METRICS_FILE, config, artefacts, source.map)
        self._seconds[scene.id] = {
            use: one.record.seconds
            for use, one in sorted(artefacts.items())
            if use.startswith(SCENE_PARTS)
        }
        metrics = read_metrics(out / METRICS_FILE)
        return scene_rows(scene, config, source.log.name, self._names, metrics, artefacts, errors)

    def seconds(self) -> dict[str, dict[str, float]]:
        """By scene, what its artefacts took, whichever grid made them."""
        return self._seconds
