"""The table of a grid, paired differences, agreement with the truth: in a file and printed."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import asdict, dataclass, replace
from typing import Any

from rich.table import Table

from recast.evaluation.grid import (
    ArmSummary,
    GridRow,
    PairedDifference,
    arm_summaries,
    paired_summaries,
)
from recast.evaluation.pairs import Bootstrap
from recast.evaluation.table import COLUMNS, rounded
from recast.evaluation.verdicts import VerdictCounts, agreements
from recast.pipeline.arms import truth_of
from recast.pipeline.bench.grid import BENCH_FORMAT, BENCH_VERSION, BenchSettings
from recast.pipeline.display import narrow_table

_HEADLINE = {name: column for name, column in COLUMNS.items() if column.headline}
_DIGITS = {"s": 2, "%": 1}


@dataclass(frozen=True)
class GridResults:
    """What a grid shows.

    Attributes:
        differences: of every arm from the first, by planner.
        table, truth: a line for each planner and arm; for each that was compared with the truth.
    """

    rows: tuple[GridRow, ...]
    table: tuple[ArmSummary, ...]
    differences: tuple[PairedDifference, ...]
    truth: tuple[VerdictCounts, ...]


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
    return rounded(
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
            "differences": [asdict(one) for one in results.differences],
            "truth": [_agreement(one) for one in results.truth],
            "failures": [_failure(row) for row in failed],
        }
    )


def _line(line: ArmSummary) -> dict[str, Any]:
    return {
        **line.row.to_json(),
        "intervals": {name: _interval(one) for name, one in line.intervals.items()},
    }


def _agreement(one: VerdictCounts) -> dict[str, Any]:
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


def grid_table(lines: Sequence[ArmSummary], title: str) -> Table:
    """A line for each arm: means with their intervals over scenes.

    Below the names stands how many rollouts were scored, of how many. A metric that not every one
    of them has says over how many it is.
    """
    table = narrow_table(title, ["arm"], [column.heading for column in _HEADLINE.values()])
    for line in lines:
        row = line.row
        told = [broken_name(row.arm), f"{row.rollouts} of {row.asked}", f"{row.plans} plans"]
        told += [f"{n} {what}" for n, what in ((row.failed, "failed"), (row.cut, "cut")) if n]
        table.add_row("\n".join(told), *(_mean(line, name) for name in _HEADLINE))
    return table


def differences_table(differences: Sequence[PairedDifference]) -> Table:
    """A line for each headline metric of each arm: its difference from the first arm."""
    level = 100 * differences[0].sampled.level
    scenes = max(one.scenes for one in differences)
    baseline = f"minus\n{broken_name(differences[0].baseline)}"
    title = f"paired differences, {scenes} scenes drawn whole"
    figures = ["mean", f"{level:g} % sampled", "exact", "pairs", "plans"]
    table = narrow_table(title, [baseline, "metric"], figures)
    for one in differences:
        if one.metric not in _HEADLINE:
            continue
        column = _HEADLINE[one.metric]
        digits = _DIGITS[column.unit]
        table.add_row(
            broken_name(one.candidate),
            f"{column.label} {column.unit}",
            f"{one.sampled.point:+.{digits}f}",
            _signed(one.sampled, digits),
            "n/a" if one.exact is None else _signed(one.exact, digits),
            _pairs(one),
            str(one.plans),
        )
    return table


def truth_table(lines: Sequence[VerdictCounts]) -> Table:
    """A line for each arm: whether its rollouts end as the truth's do.

    False are collisions that the truth's rollouts do not have, missed are those that they have.
    """
    figures = ["same verdict", "%", "false", "missed", "TTC error s", "pairs", "plans"]
    table = narrow_table("against the truth", ["arm"], figures)
    for one in lines:
        share = replace(
            one.share,
            point=100 * one.share.point,
            low=100 * one.share.low,
            high=100 * one.share.high,
        )
        table.add_row(
            broken_name(one.arm),
            f"{one.agreeing}/{one.pairs}",
            f"{share.point:.1f}\n{_range(share, 1)}",
            str(one.false_collisions),
            str(one.missed_collisions),
            "n/a"
            if one.ttc_error is None
            else f"{one.ttc_error.point:.3f}\n{_range(one.ttc_error, 3)}",
            _pairs(one),
            str(one.plans),
        )
    return table


def times_line(times: Mapping[str, Any]) -> str:
    """Where the time went, in one line."""
    whole, session = times["all"], times["sessions"][-1]
    shares = ", ".join(
        f"{name} {100 * share:.0f} %"
        for name, share in whole["shares"].items()
        if share is not None
    )
    return (
        f"{session['seconds']:.0f} s with --workers {session['workers']} for "
        f"{session['rollouts']} rollouts; all {whole['rollouts']} took {whole['seconds']:.0f} s"
        + (f": {shares}" if shares else "")
    )


def broken_name(arm: str) -> str:
    """The name of an arm as narrow columns break it."""
    return arm.replace("+", "+\n")


def _mean(line: ArmSummary, name: str) -> str:
    mean, digits = line.row.means[name], _DIGITS[COLUMNS[name].unit]
    if mean is None:
        return "n/a"
    shown = [f"{mean:.{digits}f}", _range(line.intervals[name], digits)]
    count = line.row.counts[name]
    if COLUMNS[name].passes:
        shown.insert(1, f"{round(mean * count / 100)}/{count}")
    elif count < line.row.rollouts:
        shown.insert(1, f"of {count}")
    return "\n".join(shown)


def _pairs(one: PairedDifference | VerdictCounts) -> str:
    """How many of how many, and how many of them end where one of the two was cut."""
    pairs = f"{one.pairs}/{one.asked}"
    return f"{pairs}\n{one.cut} cut" if one.cut else pairs


def _range(one: Bootstrap, digits: int) -> str:
    return f"{one.low:.{digits}f}-{one.high:.{digits}f}".replace("100.0", "100")


def _signed(one: Bootstrap, digits: int) -> str:
    return f"[{one.low:+.{digits}f}, {one.high:+.{digits}f}]".replace("100.0", "100")
