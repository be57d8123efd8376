"""Rows of `recast trellis verify`, `recast recar stats` and `recast recar targets`."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import Any

from recast.cli.output import Rows
from recast.recar.statistics import SetStatistics
from recast.recar.targets import TargetCache
from recast.recar.targets.statistics import TargetStatistics
from recast.trellis.checkpoints.check import ModelCheck


def check_rows(checks: Sequence[ModelCheck]) -> Rows:
    """One row for each model of a folder; `problem` is null if nothing is wrong."""
    rows = []
    for check in checks:
        fault = check.fault()
        rows.append(
            {
                "role": check.role,
                "class": check.class_name,
                "file": check.file,
                "tensors": None if check.found is None else len(check.found),
                "tensors_expected": None if check.expected is None else len(check.expected),
                "size_bytes": check.bytes_found,
                "parameters": check.parameters,
                "note": check.note or None,
                "problem": None if fault is None else str(fault),
            }
        )
    return {"models": rows}


def set_rows(statistics: SetStatistics) -> Rows:
    """Counts of a vehicle set, its kinds and colours, and the sizes of its vehicles."""
    total = {
        "identities": statistics.identities,
        "train": statistics.splits["train"],
        "held_out": statistics.splits["held-out"],
        "pictures": statistics.pictures,
        "size_bytes": statistics.bytes,
    }
    sizes = statistics.sizes or ()
    return {
        "set": [total],
        "kinds": _counts("kind", statistics.kinds),
        "colours": _counts("colour", statistics.colours),
        "sizes": [
            {
                "statistic": statistic,
                "length_m": size[0],
                "width_m": size[1],
                "height_m": size[2],
            }
            for statistic, size in zip(("minimum", "median", "maximum"), sizes, strict=False)
        ],
    }


def target_rows(cache: TargetCache, statistics: TargetStatistics) -> Rows:
    """Counts of a target cache, and the reasons for missing targets."""
    least, median, most = statistics.voxels
    total: dict[str, Any] = {
        "model": cache.record.model.name,
        "done": statistics.done,
        "failed": sum(statistics.failures.values()),
        "accepted_train": statistics.accepted["train"],
        "accepted_held_out": statistics.accepted["held-out"],
        "below_threshold": statistics.below,
        "rejected": statistics.rejected,
        "doubtful": statistics.doubtful,
        "voxels_minimum": least,
        "voxels_median": median,
        "voxels_maximum": most,
        "score": cache.record.filter.score or None,
        "threshold": cache.record.filter.threshold,
    }
    reasons = [
        {"reason": reason, "vehicles": count} for reason, count in statistics.failures.items()
    ]
    return {"targets": [total], "failures": reasons}


def _counts(name: str, counts: Mapping[str, int]) -> list[dict[str, Any]]:
    return [{name: one, "identities": count} for one, count in counts.items()]
