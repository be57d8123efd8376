"""The table of a grid, paired differences, agreement with the truth: in a file and printed."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import asdict, dataclass
from typing import Any

from rich.table import Table

from recast.metrics.pairs import Bootstrap
from recast.metrics.table import COLUMNS, rounded
from recast.runs.arms import truth_of
from recast.runs.display import narrow_table
from recast.studies.grid import BENCH_FORMAT, BENCH_VERSION, BenchSettings
from recast.studies.grid_rows import (
    ArmSummary,
    GridRow,
    PairedDifference,
    arm_summaries,
    paired_summaries,
)
from recast.studies.verdict_parts import PartLoss, part_losses, parts_of
from recast.studies.verdicts import VerdictCounts, agreements, noise_floors

_HEADLINE = {name: column for name, column in COLUMNS.items() if column.headline}
_DIGITS = {"s": 2, "%": 1}


@dataclass(frozen=True)
class GridResults:
    """What a grid shows.

    Attributes:
        differences: differences of every arm from the first, by planner.
        table: a line for each planner and arm.
        truth: a line for each planner and arm that was compared with the truth.
        floors: agreement of the truth with the disturbed truth, by planner; empty without arms of
            noise.
        losses: what each part costs, for each planner; empty without the truth.
    """

    rows: tuple[GridRow, ...]
    table: tuple[ArmSummary, ...]
    differences: tuple[PairedDifference, ...]
    truth: tuple[VerdictCounts, ...]
    floors: Mapping[str, VerdictCounts]
    losses: tuple[PartLoss, ...]


def summarise(rows: Sequence[GridRow], settings: BenchSettings) -> GridResults:
    """The results of all rows; the bootstrap draws by the grid's seed."""
    samples, seed, arms = settings.samples, settings.run.seed, settings.run.arms
    arms = tuple(settings.run.arm(arm.name) for arm in arms)
    truth, noisy = truth_of(arms), [arm.name for arm in arms if arm.is_truth and arm.noise]
    drawn = (samples, seed)
    compared = [] if truth is None else agreements(rows, truth, *drawn)
    floors = [] if truth is None else noise_floors(rows, truth, noisy, *drawn)
    losses = [] if truth is None else part_losses(rows, truth, parts_of(arms), *drawn)
    return GridResults(
        rows=tuple(rows),
        table=tuple(arm_summaries(rows, *drawn)),
        differences=tuple(paired_summaries(rows, arms[0].name, *drawn)),
        truth=tuple(compared),
        floors={one.planner: one for one in floors},
        losses=tuple(losses),
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
            "truth": [_agreement(one, results.floors) for one in results.truth],
            "noise_floors": [_agreement(one, {}) for one in results.floors.values()],
            "decomposition": [
                {**asdict(one), "loss": _interval(one.loss)} for one in results.losses
            ],
            "trust": [_trusted(row) for row in results.rows if row.trust is not None],
            "failures": [_failure(row) for row in failed],
        }
    )


def _line(line: ArmSummary) -> dict[str, Any]:
    return {
        **line.row.to_json(),
        "intervals": {name: _interval(one) for name, one in line.intervals.items()},
    }


def _agreement(one: VerdictCounts, floors: Mapping[str, VerdictCounts]) -> dict[str, Any]:
    floor = floors.get(one.planner)
    return {
        **{k: v for k, v in vars(one).items() if not isinstance(v, Bootstrap)},
        "share": _interval(one.share),
        "noise_floor": None if floor is None else floor.share.point,
        "share_of_floor": one.over(floor),
        "ttc_error": None if one.ttc_error is None else _interval(one.ttc_error),
    }


def _interval(one: Bootstrap) -> dict[str, float]:
    return {"mean": one.point, "low": one.low, "high": one.high, "level": one.level}


def _trusted(row: GridRow) -> dict[str, Any]:
    return {**_named(row), **(row.trust or {})}


def _failure(row: GridRow) -> dict[str, Any]:
    return {**_named(row), "error": row.failure, "reason": row.failure_reason}


def _named(row: GridRow) -> dict[str, str]:
    return {name: getattr(row, name) for name in ("scene", "motion", "setting", "planner", "arm")}


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
    title = f"paired differences, bootstrap over {scenes} scenes"
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
            pairs_told(one),
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
        f"{session['rollouts']} rollouts; in total {whole['rollouts']} in {whole['seconds']:.0f} s"
        + (f": {shares}" if shares else "")
    )


def broken_name(arm: str) -> str:
    """The name of an arm as narrow columns break it."""
    return arm.replace("+", "+\n").replace(":", ":\n")


def _mean(line: ArmSummary, name: str) -> str:
    mean, digits = line.row.means[name], _DIGITS[COLUMNS[name].unit]
    if mean is None:
        return "n/a"
    shown = [f"{mean:.{digits}f}", span(line.intervals[name], digits)]
    count = line.row.counts[name]
    if COLUMNS[name].passes:
        shown.insert(1, f"{round(mean * count / 100)}/{count}")
    elif count < line.row.rollouts:
        shown.insert(1, f"of {count}")
    return "\n".join(shown)


def pairs_told(one: PairedDifference | VerdictCounts) -> str:
    """How many of how many, and how many of them end where one of the two was cut."""
    pairs = f"{one.pairs}/{one.asked}"
    return f"{pairs}\n{one.cut} cut" if one.cut else pairs


def span(one: Bootstrap, digits: int) -> str:
    """An interval without its mean."""
    return f"{one.low:.{digits}f}-{one.high:.{digits}f}".replace("100.0", "100")


def _signed(one: Bootstrap, digits: int) -> str:
    return f"[{one.low:+.{digits}f}, {one.high:+.{digits}f}]".replace("100.0", "100")
