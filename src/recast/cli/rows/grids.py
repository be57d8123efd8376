"""Rows of `recast run`, `recast demo` and `recast bench`."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

from recast.cli.shared import Rows, with_unit
from recast.metrics import COLUMNS
from recast.metrics.scene_level.summary import LevelRow
from recast.metrics.table import Bootstrap
from recast.metrics.trust import Reliability
from recast.runs.run_folder import METRICS_FILE
from recast.runs.scores import read_metrics
from recast.studies.closed_loop import GridResults
from recast.studies.verdicts import PartLoss, VerdictCounts


def run_rows(folder: Path) -> Rows:
    """The arms of a finished run, the trust in its verdicts, and its failed rollouts.

    Raises:
        InputError: the folder holds no metrics that this version reads.
    """
    metrics = read_metrics(folder / METRICS_FILE)
    failures = [{"rollout": one["name"], "reason": one["reason"]} for one in metrics["failures"]]
    trust = [
        {
            "rollout": one["name"],
            "planner": one["planner"],
            "trust": one["trust"]["value"],
            "reason": one["trust"]["words"],
        }
        for one in metrics["rollouts"]
        if one["trust"] is not None
    ]
    arms = [_arm(row) for row in metrics["table"]]
    return {"arms": arms, "trust": trust, "failures": failures}


def grid_rows(results: GridResults) -> Rows:
    """Arms with intervals over scenes, paired differences, verdicts, and failed rollouts."""
    arms = [
        {
            **_arm(line.row.to_json()),
            **{
                with_unit(f"{name}_{end}", COLUMNS[name].unit): getattr(interval, end)
                for name, interval in line.intervals.items()
                for end in ("low", "high")
            },
        }
        for line in results.table
    ]
    differences = [
        {
            **{key: value for key, value in vars(one).items() if key not in ("sampled", "exact")},
            "unit": COLUMNS[one.metric].unit,
            "mean": one.sampled.point,
            **_interval("sampled", one.sampled),
            **_interval("exact", one.exact),
        }
        for one in results.differences
    ]
    failures = [
        {
            "scene": row.scene,
            "motion": f"{row.motion}-{row.setting}",
            "planner": row.planner,
            "arm": row.arm,
            "error": row.failure,
            "reason": row.failure_reason,
        }
        for row in results.rows
        if row.failure is not None
    ]
    return {
        "arms": arms,
        "differences": differences,
        "against_the_truth": [
            {**_verdicts(one), **_floor(one, results.floors.get(one.planner))}
            for one in results.truth
        ],
        "decomposition": [_loss(one) for one in results.losses],
        "failures": failures,
    }


def trust_rows(found: Mapping[str, Reliability]) -> Rows:
    """Scores of a trust figure, and its bins; `data` is "left out" or "validation"."""
    names = ("scenes", "rollouts", "agreeing", "auc", "verdict_auc", "brier", "base_brier")
    scores = [
        {"data": data, **{name: getattr(one, name) for name in names}}
        for data, one in found.items()
    ]
    bins = [{"data": data, **vars(b)} for data, one in found.items() for b in one.bins]
    return {"scores": scores, "bins": bins}


def level_rows(lines: Sequence[LevelRow]) -> Rows:
    """One row for each arm and score, with intervals over scenes; scores have no unit."""
    rows = []
    for line in lines:
        for score, value in line.values.items():
            difference = value.difference or (None, None, None)
            rows.append(
                {
                    "arm": line.arm,
                    "images": line.images,
                    "score": score,
                    **vars(value),
                    "difference": difference[0],
                    "difference_low": difference[1],
                    "difference_high": difference[2],
                }
            )
    return {"scores": rows}


def _arm(row: Mapping[str, Any]) -> dict[str, Any]:
    counted = ("planner", "arm", "asked", "rollouts", "failed", "cut", "plans")
    known = [name for name in COLUMNS if name in row["means"]]
    return {
        **{name: row[name] for name in counted},
        **{with_unit(name, COLUMNS[name].unit): row["means"][name] for name in known},
        **{f"{name}_rollouts": row["counts"][name] for name in known},
    }


def _interval(name: str, interval: Bootstrap | None) -> dict[str, float | None]:
    if interval is None:
        return {f"{name}_low": None, f"{name}_high": None}
    return {f"{name}_low": interval.low, f"{name}_high": interval.high}


def _verdicts(one: VerdictCounts) -> dict[str, Any]:
    error = one.ttc_error
    return {
        "planner": one.planner,
        "arm": one.arm,
        "same_verdict": one.agreeing,
        "pairs": one.pairs,
        "asked": one.asked,
        "same_verdict_percent": 100 * one.share.point,
        "same_verdict_low_percent": 100 * one.share.low,
        "same_verdict_high_percent": 100 * one.share.high,
        "false_collisions": one.false_collisions,
        "missed_collisions": one.missed_collisions,
        "ttc_error_s": None if error is None else error.point,
        "ttc_error_low_s": None if error is None else error.low,
        "ttc_error_high_s": None if error is None else error.high,
        "plans": one.plans,
        "cut": one.cut,
    }


def _floor(one: VerdictCounts, floor: VerdictCounts | None) -> dict[str, float | None]:
    ratio = one.over(floor)
    return {
        "noise_floor_percent": None if floor is None else 100 * floor.share.point,
        "of_noise_floor_percent": None if ratio is None else 100 * ratio,
    }


def _loss(one: PartLoss) -> dict[str, Any]:
    return {
        **{key: value for key, value in vars(one).items() if key != "loss"},
        "loss_percent": 100 * one.loss.point,
        "loss_low_percent": 100 * one.loss.low,
        "loss_high_percent": 100 * one.loss.high,
    }
