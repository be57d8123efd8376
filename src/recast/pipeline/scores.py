"""metrics.json: everything that a run measured."""

from __future__ import annotations

from pathlib import Path

from recast import storage
from recast.actors import load_actor
from recast.evaluation import rollout_metrics, table
from recast.logs import HdMap
from recast.pipeline.config import RunConfig
from recast.pipeline.layout import (
    ACTOR_FOLDER,
    EVALUATION_FOLDER,
    METRICS_FILE,
    ROLLOUTS_FOLDER,
    TRUTH_FOLDER,
)
from recast.pipeline.rollouts import read_rollout
from recast.simulation import RolloutFailure


def write_metrics(run: Path, config: RunConfig, hd_map: HdMap) -> None:
    """Score all rollouts of a run and write them with what its other steps measured.

    Args:
        run: run folder with rollouts; actor, evaluation and truth where they were made.
        hd_map: lanes and drivable area that the rollouts are judged by.
    """
    metrics, failures = [], []
    for motion in config.motions:
        for method in config.methods:
            result = read_rollout(run / ROLLOUTS_FOLDER / motion / method)
            if isinstance(result, RolloutFailure):
                failures.append(result)
            else:
                metrics.append(rollout_metrics(result, hd_map))
    evaluation = run / EVALUATION_FOLDER / "eval.json"
    views = run / TRUTH_FOLDER / "oracle_views.json"
    actor = run / ACTOR_FOLDER
    storage.write_json(
        run / METRICS_FILE,
        {
            "version": 1,
            "table": [row.to_json() for row in table(metrics, failures)],
            "rollouts": [m.to_json() for m in metrics],
            "failures": [vars(f) for f in failures],
            "scene": storage.read_json(evaluation) if evaluation.exists() else None,
            "truth": storage.read_json(views) if views.exists() else None,
            "actor": load_actor(actor).provenance.model_dump(mode="json")
            if actor.is_dir()
            else None,
        },
    )
