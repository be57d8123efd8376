"""The rows of a scene whose rollouts are all made."""

from __future__ import annotations

from typing import Any

from recast.evaluation.grid_row import GridRow
from recast.evaluation.same_script import script_difference
from recast.pipeline.bench.scene_run import SceneRun
from recast.pipeline.bench.scenes import BenchScene
from recast.pipeline.bench.tasks import ScoreTask
from recast.pipeline.config import RunConfig
from recast.pipeline.layout import METRICS_FILE, Method
from recast.pipeline.results_files import read_metrics
from recast.pipeline.rollouts import read_rollout
from recast.simulation import Rollout

OTHER_SCRIPT = "OtherScript"
"""Error of a row whose actor, route or start is not that of the other methods."""


def blank_row(
    scene: BenchScene, config: RunConfig, motion: str, method: Method, planner: str
) -> GridRow:
    """The row of a rollout of which nothing is known yet."""
    found = config.motion(motion)
    return GridRow(
        scene=scene.id,
        world=scene.world,
        seed=scene.seed,
        motion=found.name,
        setting=found.setting,
        method=method,
        planner=planner,
    )


def score_scene(run: SceneRun, task: ScoreTask) -> tuple[GridRow, ...]:
    """Write metrics.json of a scene and return its rows, by motion, then by method.

    Every method must have been given the same actor states, the same route and the same start: a
    row that was not is a failure.
    """
    run.score(dict(task.rollouts))
    metrics = read_metrics(run.job.path / METRICS_FILE)
    scored = {_key(one): one for one in metrics["rollouts"]}
    failures = {_key(one): one for one in metrics["failures"]}
    rows = []
    for motion in run.job.config.motions:
        first: Rollout | None = None
        for method in run.job.config.methods:
            row = blank_row(task.scene, run.job.config, motion, method, run.job.planner.name)
            row = row.of_log(run.job.log.name, run.job.config.track)
            key = (row.motion, row.setting, method)
            if key in failures:
                rows.append(row.failed(failures[key]["error"], failures[key]["reason"]))
                continue
            rollout = read_rollout(run.rollout_folder(motion, method))
            assert isinstance(rollout, Rollout)  # or else it is among the failures
            first = first or rollout
            differs = script_difference(first, rollout)
            if differs is None:
                rows.append(row.scored(scored[key]))
            else:
                rows.append(row.failed(OTHER_SCRIPT, f"{differs}, compared with {first.method}"))
    return tuple(rows)


def _key(entry: dict[str, Any]) -> tuple[str, str, str]:
    return entry["motion"], entry["setting"], entry["method"]
