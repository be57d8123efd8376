"""metrics.json: everything that a run measured."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path
from typing import Any

from recast import storage
from recast.actors import load_actor
from recast.evaluation import COLUMNS, RolloutMetrics, matched_pairs, rollout_metrics, table
from recast.logs import HdMap
from recast.pipeline.config import RunConfig
from recast.pipeline.layout import (
    EVALUATION_FOLDER,
    METRICS_FILE,
    TRUTH_FOLDER,
    final_actor,
    rollout_folder,
)
from recast.pipeline.results_files import METRICS_VERSION
from recast.pipeline.rollouts import read_coverage, read_rollout
from recast.simulation import RolloutFailure
from recast.simulation.coverage import RolloutCoverage


def write_metrics(run: Path, config: RunConfig, hd_map: HdMap) -> None:
    """Score all rollouts of a run and write them with what its other steps measured.

    Each rollout's entry has, besides `RolloutMetrics.to_json`, a member `shorter`: by number of
    steps, its scores over the first steps alone, for each length at which the rollout of another
    method was cut in the same scenario. And `coverage`: what its cameras showed of an actor with
    shares, see `RolloutCoverage.to_json`, or None.

    Args:
        run: run folder with rollouts; actor, evaluation and truth where they were made.
        hd_map: lanes and drivable area that the rollouts are judged by.
    """
    metrics: list[RolloutMetrics] = []
    coverages: list[RolloutCoverage | None] = []
    failures: list[RolloutFailure] = []
    for motion in config.motions:
        for method in config.methods:
            result = read_rollout(rollout_folder(run, motion, method))
            if isinstance(result, RolloutFailure):
                failures.append(result)
                continue
            metrics.append(rollout_metrics(result, hd_map))
            coverages.append(read_coverage(rollout_folder(run, motion, method)))
    evaluation = run / EVALUATION_FOLDER / "eval.json"
    views = run / TRUTH_FOLDER / "oracle_views.json"
    actor = final_actor(run)
    storage.write_json(
        run / METRICS_FILE,
        {
            "version": METRICS_VERSION,
            "table": [row.to_json() for row in table(metrics, failures)],
            "differences": [
                one
                for method in config.methods[1:]
                for one in _differences(metrics, failures, method, config.methods[0])
            ],
            "rollouts": [
                {
                    **one.to_json(),
                    "shorter": _shorter(one, metrics),
                    "coverage": None if coverage is None else coverage.to_json(),
                }
                for one, coverage in zip(metrics, coverages, strict=True)
            ],
            "failures": [vars(f) for f in failures],
            "scene": storage.read_json(evaluation) if evaluation.exists() else None,
            "truth": storage.read_json(views) if views.exists() else None,
            "actor": load_actor(actor).provenance.model_dump(mode="json")
            if actor.is_dir()
            else None,
        },
    )


def _shorter(one: RolloutMetrics, others: Sequence[RolloutMetrics]) -> dict[str, Any]:
    lengths = {
        other.steps_run
        for other in others
        if (other.motion, other.setting) == (one.motion, one.setting)
        and other.steps_run < one.steps_run
    }
    parts = {steps: one.over(steps).values for steps in sorted(lengths)}
    return {str(n): {key: values[key].value for key in COLUMNS} for n, values in parts.items()}


def _differences(
    metrics: Sequence[RolloutMetrics],
    failures: Sequence[RolloutFailure],
    candidate: str,
    baseline: str,
) -> list[dict[str, Any]]:
    """A line for each metric that a pair has: the mean in the column's unit, and over what."""
    pairs = matched_pairs({"": metrics}, candidate, baseline, {"": failures})
    found = []
    for name, column in COLUMNS.items():
        one = pairs.of(name)
        if one.pairs == 0:
            continue
        mean = column.scale * float(one.differences[""].mean())
        found.append(
            {
                "candidate": candidate, "baseline": baseline, "metric": name, "mean": mean,
                "pairs": one.pairs, "asked": one.asked, "plans": one.plans, "cut": one.cut,
            }
        )  # fmt: skip
    return found
