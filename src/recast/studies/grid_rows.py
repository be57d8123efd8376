"""The rollouts of a grid as rows, their table with intervals, and how the arms differ."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field, replace
from typing import Any

import numpy as np

from recast.arrays import Array
from recast.metrics.pairs import (
    MOST_EXACT,
    Bootstrap,
    cluster_bootstrap,
    exact_bootstrap,
    matched_pairs,
)
from recast.metrics.table import COLUMNS, Metric, TableRow, invalid, table

_ASKED = (
    *("scene", "world", "seed", "motion", "setting", "arm", "planner", "log", "track_id"),
    "steps_requested",
)
"""Members of a row that are known before it is run."""


@dataclass(frozen=True)
class GridRow:
    """A rollout of a grid of scenes, motions, settings and arms.

    Attributes:
        scene: its id in the grid.
        world, seed: world and seed of a synthetic scene, else None.
        log: name of the log; None where there is none.
        track_id: the controlled actor; None where the scene failed before it was known.
        motion, setting, arm, planner: the rollout's fields of the same names, see `Rollout`.
        start_timestamp_us, steps_requested, steps_run, cut_reason: fields of the same names, see
            `RolloutMetrics`; None where the rollout failed.
        plan_steps: steps at which plans were made; empty where the rollout failed.
        first_collision_step: step of the first collision; None where there was no collision.
        map_derived: field of the same name, see `RolloutMetrics`.
        scores: scores by metric, keys of `COLUMNS`, plain values (shares between 0 and 1, seconds);
            None where a metric is not valid. Empty where the rollout failed.
        shorter: the same scores of the first steps alone, by how many steps: for each length at
            which the rollout of another arm in the scenario was cut.
        trust: how far to trust the verdict, see `RolloutTrust.to_json`; None for the truth, and
            where the rollout failed.
        failure: class of the error; None where the rollout was scored.
        failure_reason: its message.
    """

    scene: str
    world: str | None
    seed: int | None
    motion: str
    setting: str
    arm: str
    planner: str
    log: str | None = None
    track_id: str | None = None
    start_timestamp_us: int | None = None
    steps_requested: int | None = None
    steps_run: int | None = None
    cut_reason: str | None = None
    plan_steps: tuple[int, ...] = ()
    first_collision_step: int | None = None
    map_derived: bool | None = None
    scores: Mapping[str, float | None] = field(default_factory=dict)
    shorter: Mapping[int, Mapping[str, float | None]] = field(default_factory=dict)
    trust: Mapping[str, Any] | None = None
    failure: str | None = None
    failure_reason: str | None = None

    def of_log(self, log: str, track_id: str) -> GridRow:
        """This row with the log and the track it was run on."""
        return replace(self, log=log, track_id=track_id)

    def scored(self, metrics: Mapping[str, Any]) -> GridRow:
        """This row with an entry of metrics.json, see `recast.runs.scores`."""
        per_step = metrics["per_step"]
        return replace(
            self,
            start_timestamp_us=metrics["start_timestamp_us"],
            steps_requested=metrics["steps_requested"],
            steps_run=metrics["steps_run"],
            cut_reason=metrics["cut_reason"],
            plan_steps=tuple(metrics["per_cycle"]["plan_steps"]),
            first_collision_step=per_step["first_collision_step"],
            map_derived=per_step["map_derived"],
            scores={name: metrics["metrics"][name]["value"] for name in COLUMNS},
            shorter={
                int(steps): {name: scores[name] for name in COLUMNS}
                for steps, scores in metrics["shorter"].items()
            },
            trust=metrics["trust"],
        )

    def over(self, steps: int) -> GridRow:
        """This row, had the rollout ended after `steps`: its own length, or one of `shorter`."""
        if steps == self.steps_run:
            return self
        return replace(
            self,
            steps_run=steps,
            scores=self.shorter[steps],
            shorter={},
            plan_steps=tuple(step for step in self.plan_steps if step < steps),
        )

    def failed(self, error: str, reason: str) -> GridRow:
        """This row without scores, and why."""
        asked = {name: getattr(self, name) for name in _ASKED}
        return GridRow(**asked, failure=error, failure_reason=reason)

    @property
    def plans(self) -> int:
        """How many plans were made."""
        return len(self.plan_steps)

    @property
    def values(self) -> Mapping[str, Metric]:
        """Every metric by name."""
        found = {name: self.scores.get(name) for name in COLUMNS}
        return {n: invalid("no value") if v is None else Metric(v) for n, v in found.items()}

    @property
    def collided(self) -> bool | None:
        """The verdict; None where the rollout failed."""
        nc = self.scores.get("nc")
        return None if nc is None else nc == 0.0

    @property
    def scenario(self) -> tuple[str, str, str, str]:
        """What rollouts have in common that differ in the arm only."""
        return self.scene, self.motion, self.setting, self.planner


@dataclass(frozen=True)
class ArmSummary:
    """An arm's line.

    Attributes:
        row: means, see `TableRow`.
        intervals: intervals by metric, in the column's unit, over scenes drawn whole; none where no
            rollout has a value.
    """

    row: TableRow
    intervals: Mapping[str, Bootstrap]


@dataclass(frozen=True)
class PairedDifference:
    """Candidate minus baseline of a metric, in the column's unit, on the scenarios of both.

    Attributes:
        candidate, baseline: arms.
        metric: key of `COLUMNS`.
        scenes, pairs: how many both have a value for.
        plans, cut, asked: see `recast.metrics.pairs.PairedMetric`.
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
        samples: number of bootstrap samples.
        seed: seed of the bootstrap; every interval sees the same draws.
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
        samples: number of bootstrap samples.
        seed: seed of the bootstrap; every interval sees the same draws.
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
                counts = (len(values), one.pairs, one.plans, one.cut, one.asked)
                sampled = cluster_bootstrap(values, np.random.default_rng(seed), samples)
                exact = exact_bootstrap(values) if len(values) <= MOST_EXACT else None
                who = (planner, candidate, baseline, name)
                found.append(PairedDifference(*who, *counts, sampled, exact))
    return found


def _by_scene(rows: Sequence[GridRow], name: str) -> list[Array]:
    scenes: dict[str, list[float]] = {}
    for row in rows:
        value = row.scores.get(name)
        if value is not None:
            scenes.setdefault(row.scene, []).append(COLUMNS[name].scale * value)
    return [np.array(values) for values in scenes.values()]
