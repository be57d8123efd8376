"""results.json: the table of a grid, the paired differences, and the agreement with the truth."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import asdict, dataclass
from typing import Any

from recast.evaluation.bootstrap import Bootstrap
from recast.evaluation.grid_row import GridRow
from recast.evaluation.grid_summary import (
    ArmSummary,
    PairedDifference,
    arm_summaries,
    paired_summaries,
)
from recast.evaluation.rounding import rounded
from recast.evaluation.table import COLUMNS
from recast.evaluation.verdicts import Agreement, agreements
from recast.pipeline.arms import truth_of
from recast.pipeline.bench.settings import BENCH_FORMAT, BENCH_VERSION, BenchSettings


@dataclass(frozen=True)
class GridResults:
    """What a grid shows.

    Attributes:
        rows: of all rollouts.
        table: a line for each planner and arm.
        differences: of every arm from the first, by planner.
        truth: a line for each planner and arm that was compared with the truth.
    """

    rows: tuple[GridRow, ...]
    table: tuple[ArmSummary, ...]
    differences: tuple[PairedDifference, ...]
    truth: tuple[Agreement, ...]


def summarise(rows: Sequence[GridRow], settings: BenchSettings) -> GridResults:
    """The results of all rows; the bootstrap draws by the grid's seed."""
    samples, seed, arms = settings.samples, settings.run.seed, settings.run.arms
    truth = truth_of(arms)
    return GridResults(
        tuple(rows),
        tuple(arm_summaries(rows, samples, seed)),
        tuple(paired_summaries(rows, arms[0].name, samples, seed)),
        () if truth is None else tuple(agreements(rows, truth, samples, seed)),
    )


def results_json(results: GridResults, settings: BenchSettings) -> dict[str, Any]:
    """Plain data without times: the same grid gives the same bytes."""
    config = settings.run
    failed = [row for row in results.rows if row.failure is not None]
    value: dict[str, Any] = rounded(
        {
            "format": BENCH_FORMAT,
            "version": BENCH_VERSION,
            "planners": list(config.planners),
            "baseline": config.arms[0].name,
            "scenes": [scene.id for scene in settings.scenes],
            "motions": list(config.motions),
            "arms": [arm.name for arm in config.arms],
            "steps": config.steps,
            "rollouts": len(results.rows),
            "failed": len(failed),
            "samples": settings.samples,
            "seed": config.seed,
            "units": {name: column.unit for name, column in COLUMNS.items()},
            "table": [_line(line) for line in results.table],
            "differences": [_difference(one) for one in results.differences],
            "truth": [_agreement(one) for one in results.truth],
            "failures": [_failure(row) for row in failed],
        }
    )
    return value


def _line(line: ArmSummary) -> dict[str, Any]:
    return {
        **line.row.to_json(),
        "intervals": {name: _interval(one) for name, one in line.intervals.items()},
    }


def _difference(one: PairedDifference) -> dict[str, Any]:
    return {
        "planner": one.planner,
        "candidate": one.candidate,
        "baseline": one.baseline,
        "metric": one.metric,
        "scenes": one.scenes,
        "pairs": one.pairs,
        "asked": one.asked,
        "plans": one.plans,
        "cut": one.cut,
        "sampled": asdict(one.sampled),
        "exact": None if one.exact is None else asdict(one.exact),
    }


def _agreement(one: Agreement) -> dict[str, Any]:
    return {
        **{k: v for k, v in vars(one).items() if not isinstance(v, Bootstrap)},
        "share": _interval(one.share),
        "ttc_error": None if one.ttc_error is None else _interval(one.ttc_error),
    }


def _interval(one: Bootstrap) -> dict[str, float]:
    return {"mean": one.point, "low": one.low, "high": one.high, "level": one.level}


def _failure(row: GridRow) -> dict[str, Any]:
    return {
        "scene": row.scene,
        "motion": row.motion,
        "setting": row.setting,
        "planner": row.planner,
        "arm": row.arm,
        "error": row.failure,
        "reason": row.failure_reason,
    }
