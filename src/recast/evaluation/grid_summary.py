"""The table of a grid with intervals, and how the arms differ on the same scenarios."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from recast.evaluation.bootstrap import MOST_EXACT, Bootstrap, cluster_bootstrap, exact_bootstrap
from recast.evaluation.grid_row import GridRow
from recast.evaluation.pairs import matched_pairs
from recast.evaluation.table import COLUMNS, TableRow, table

Array = NDArray[np.float64]


@dataclass(frozen=True)
class ArmSummary:
    """An arm's line.

    Attributes:
        row: means, see `TableRow`.
        intervals: by metric, in the column's unit, over scenes drawn whole; none where no rollout
            has a value.
    """

    row: TableRow
    intervals: Mapping[str, Bootstrap]


@dataclass(frozen=True)
class PairedDifference:
    """Candidate minus baseline of a metric, in the column's unit, on the scenarios of both.

    Attributes:
        planner: of all rollouts.
        candidate, baseline: arms.
        metric: key of `COLUMNS`.
        scenes, pairs: how many both have a value for.
        plans, cut, asked: see `recast.evaluation.pairs.PairedMetric`.
        sampled: the bootstrap over scenes.
        exact: the same by enumeration; None where there are too many scenes.
    """

    planner: str
    candidate: str
    baseline: str
    metric: str
    scenes: int
    pairs: int
    plans: int
    cut: int
    asked: int
    sampled: Bootstrap
    exact: Bootstrap | None


def arm_summaries(rows: Sequence[GridRow], samples: int, seed: int) -> list[ArmSummary]:
    """The table: a line for each arm, in the order in which they first occur.

    Args:
        samples, seed: of the bootstrap; every interval sees the same draws.
    """
    # By its first row, whether that failed or not: the order is that of the grid.
    order = {key: i for i, key in enumerate(dict.fromkeys((r.planner, r.arm) for r in rows))}
    scored = [row for row in rows if row.failure is None]
    lines = table(scored, [row for row in rows if row.failure is not None])
    lines.sort(key=lambda line: order[line.planner, line.arm])
    summaries = []
    for line in lines:
        mine = [r for r in scored if (r.planner, r.arm) == (line.planner, line.arm)]
        intervals = {
            name: cluster_bootstrap(scenes, np.random.default_rng(seed), samples)
            for name in COLUMNS
            if (scenes := _by_scene(mine, name))
        }
        summaries.append(ArmSummary(line, intervals))
    return summaries


def paired_summaries(
    rows: Sequence[GridRow], baseline: str, samples: int, seed: int
) -> list[PairedDifference]:
    """Every other arm against `baseline`, for every planner and metric that has a pair.

    Each pair is compared over the steps that both its rollouts have.

    Args:
        samples, seed: of the bootstrap; every interval sees the same draws.
    """
    found = []
    for planner in dict.fromkeys(row.planner for row in rows):
        mine = [row for row in rows if row.planner == planner]
        scored: dict[str, list[GridRow]] = {}
        failed: dict[str, list[GridRow]] = {}
        for row in mine:
            (scored if row.failure is None else failed).setdefault(row.scene, []).append(row)
        for candidate in dict.fromkeys(row.arm for row in mine if row.arm != baseline):
            pairs = matched_pairs(scored, candidate, baseline, failed)
            for name, column in COLUMNS.items():
                one = pairs.of(name)
                if one.pairs == 0:
                    continue
                values = [column.scale * scene for scene in one.differences.values()]
                found.append(
                    PairedDifference(
                        planner, candidate, baseline, name, len(values), one.pairs, one.plans,
                        one.cut, one.asked,
                        cluster_bootstrap(values, np.random.default_rng(seed), samples),
                        exact_bootstrap(values) if len(values) <= MOST_EXACT else None,
                    )
                )  # fmt: skip
    return found


def _by_scene(rows: Sequence[GridRow], name: str) -> list[Array]:
    scenes: dict[str, list[float]] = {}
    for row in rows:
        value = row.scores.get(name)
        if value is not None:
            scenes.setdefault(row.scene, []).append(COLUMNS[name].scale * value)
    return [np.array(values) for values in scenes.values()]
