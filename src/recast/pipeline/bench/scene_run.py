"""One scene of a grid: an ordinary run, of which each worker makes some of the rollouts."""

from __future__ import annotations

from pathlib import Path

from rich.console import Console

from recast.logs import read_log
from recast.pipeline.config import config_of
from recast.pipeline.job import Job
from recast.pipeline.layout import Method, rollout_folder
from recast.pipeline.methods import Renderers
from recast.pipeline.planner import run_mounts
from recast.pipeline.run_folder import RunFolder
from recast.pipeline.sources import Sources
from recast.planning import make_planner
from recast.simulation import Timings
from recast.synthetic import world_of


class SceneRun:
    """The run of a scene, opened; close it.

    Opening makes actor, scene and evaluation where they are not finished, as far as anything is
    rendered: a planner that reads states, without films, needs none of them.

    Args:
        path: run folder, begun with `RunFolder.create_or_resume`.
        sources: what stands for the exchangeable parts, taken before any of them was loaded.

    Raises:
        InputError: a faulty log or folder, or a camera that the planner wants and the log lacks.
    """

    def __init__(self, path: Path, sources: Sources) -> None:
        folder = RunFolder.open(path)
        config = config_of(folder)
        log = read_log(folder.record.log.path)
        planner = make_planner(config.planner, config.planner_device)
        looks = config.films or planner.needs_images
        methods = set(config.methods) if looks else set()
        world = world_of(log) if "oracle" in methods else None
        mounts = run_mounts(log, planner, config)
        self._renderers = Renderers(path, world, mounts, oracle_workers=1)
        console = Console(quiet=True)
        self.job = Job(log, world, folder, config, sources, planner, self._renderers, console)
        self._actor = self.job.make_actor() if "replaced" in methods else None
        self._scene = self.job.make_scene() if methods - {"oracle"} else None
        if self._actor is not None and self._scene is not None:
            self._actor = self.job.refine_actor(self._scene, self._actor)
        self._evaluation = None if self._scene is None else self.job.evaluate(self._scene)

    def rollout_folder(self, motion: str, method: Method) -> Path:
        """Where a rollout lies."""
        return rollout_folder(self.job.path, motion, method)

    def make_rollout(self, motion: str, method: Method, timings: Timings) -> str:
        """One rollout, see `Job.make_rollout`."""
        return self.job.make_rollout(motion, method, self._scene, self._actor, timings)

    def score(self, rollouts: dict[str, str]) -> str:
        """metrics.json, see `Job.score`."""
        return self.job.score(rollouts, self._evaluation, self._actor)

    def close(self) -> None:
        """Let go of the renderers."""
        self._renderers.__exit__(None, None, None)
