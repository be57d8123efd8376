"""Metrics with their validity, and the paper's table: means over rollouts by planner and arm."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import asdict, dataclass
from typing import Any, Protocol, Self

import numpy as np

DECIMALS = 6


@dataclass(frozen=True)
class Metric:
    """A metric of one rollout.

    Attributes:
        value: the number, or None where it cannot be told (no map, no plan, no route).
        reason: reason in words why the value is not the best possible or why there is none; None
            where there is nothing to explain.
    """

    value: float | None
    reason: str | None = None

    @property
    def valid(self) -> bool:
        """Whether there is a value."""
        return self.value is not None

    def to_json(self) -> dict[str, Any]:
        """Plain value, validity and reason."""
        return {"value": self.value, "valid": self.valid, "reason": self.reason}


def invalid(reason: str) -> Metric:
    """A metric without a value."""
    return Metric(None, reason)


def rounded(value: Any) -> Any:
    """Plain data with floats of six decimals; JSON knows no NaN and no infinity: they are null."""
    if isinstance(value, Mapping):
        return {key: rounded(one) for key, one in value.items()}
    if isinstance(value, list | tuple):
        return [rounded(one) for one in value]
    if isinstance(value, float):
        return round(value, DECIMALS) if math.isfinite(value) else None
    return value


@dataclass(frozen=True)
class Column:
    """How a metric is shown.

    Attributes:
        scale: shown value = scale * value.
        headline: whether the metric stands in the short tables: the paper's five metrics, and what
            was driven beside what was planned.
        passes: whether a rollout passes or fails: tables show how many of how many.
    """

    label: str
    unit: str
    scale: float
    headline: bool
    passes: bool = False

    @property
    def heading(self) -> str:
        """Label and unit, in two lines if the label has two words."""
        return f"{self.label} {self.unit}".replace(" ", "\n", int(" " in self.label))


COLUMNS: Mapping[str, Column] = {
    "nc": Column("NC", "%", 100.0, True, passes=True),
    "dac": Column("DAC", "%", 100.0, True, passes=True),
    "ttc": Column("TTC", "s", 1.0, True),
    "r_c": Column("R_c", "%", 100.0, True),
    "com": Column("COM", "%", 100.0, True),
    "com_driven": Column("COM driven", "%", 100.0, True, passes=True),
    "ttc_constant_velocity": Column("TTC (constant velocity)", "s", 1.0, False),
    "r_c_projection": Column("R_c (projection)", "%", 100.0, False),
    "com_4_13": Column("COM (jerk 4.13)", "%", 100.0, False),
    "com_nuplan_savgol": Column("COM (nuPlan, smoothed)", "%", 100.0, False),
}
"""Metrics in the order of the table. Higher is better for all."""


class Attempt(Protocol):
    """A rollout, failed or not: `RolloutFailure`, and whatever is `Scored`."""

    @property
    def planner(self) -> str:
        """Its name."""

    @property
    def arm(self) -> str:
        """What rendered it."""

    @property
    def track_id(self) -> str | None:
        """The controlled actor."""

    @property
    def motion(self) -> str:
        """What it did."""

    @property
    def setting(self) -> str:
        """How."""


class Scored(Attempt, Protocol):
    """What a rollout scored: `RolloutMetrics`, or a row of a grid; see there."""

    @property
    def steps_run(self) -> int | None:
        """Executed steps; None where the rollout failed."""

    @property
    def plans(self) -> int:
        """How many plans were made."""

    @property
    def cut_reason(self) -> str | None:
        """Why it is shorter than asked."""

    @property
    def values(self) -> Mapping[str, Metric]:
        """Metrics, keys of `COLUMNS`."""

    def over(self, steps: int) -> Self:
        """The same rollout, ended after `steps` of its steps."""


@dataclass(frozen=True)
class TableRow:
    """One line: the rollouts of a planner under a rendering arm.

    Attributes:
        rollouts: how many were scored; `failed` more ended in an error, `cut` of the scored ones
            are shorter than asked.
        plans: how many plans the scored ones made.
        means: means by metric, in the column's unit, over the rollouts where the metric is valid;
            None if there is none.
        counts: number of these rollouts, by metric.
    """

    planner: str
    arm: str
    rollouts: int
    failed: int
    cut: int
    plans: int
    means: Mapping[str, float | None]
    counts: Mapping[str, int]

    @property
    def asked(self) -> int:
        """Rollouts that were asked for: those that were scored, and those that failed."""
        return self.rollouts + self.failed

    def to_json(self) -> dict[str, Any]:
        """Plain data."""
        return {"planner": self.planner, "arm": self.arm, "asked": self.asked, **asdict(self)}


def table(metrics: Sequence[Scored], failures: Sequence[Attempt] = ()) -> list[TableRow]:
    """Rows in the order in which each planner and arm first occurs.

    A failed rollout has no metric, so it is in no mean: `TableRow` says how many there are. A cut
    one counts as it is; only pairs (see `recast.metrics.pairs`) put that right. COM is the mean
    over rollouts of the share of plans that pass; with equally many plans in each (the paper's 32)
    that is the share over all plans.
    """
    keys = dict.fromkeys(
        [(m.planner, m.arm) for m in metrics] + [(f.planner, f.arm) for f in failures]
    )
    return [_row(planner, arm, metrics, failures) for planner, arm in keys]


def _row(
    planner: str,
    arm: str,
    metrics: Sequence[Scored],
    failures: Sequence[Attempt],
) -> TableRow:
    mine = [m for m in metrics if (m.planner, m.arm) == (planner, arm)]
    means: dict[str, float | None] = {}
    counts: dict[str, int] = {}
    for name, column in COLUMNS.items():
        values = [v for m in mine if (v := m.values[name].value) is not None]
        counts[name] = len(values)
        means[name] = column.scale * float(np.mean(values)) if values else None
    return TableRow(
        planner=planner,
        arm=arm,
        rollouts=len(mine),
        failed=sum((f.planner, f.arm) == (planner, arm) for f in failures),
        cut=sum(m.cut_reason is not None for m in mine),
        plans=sum(m.plans for m in mine),
        means=means,
        counts=counts,
    )
