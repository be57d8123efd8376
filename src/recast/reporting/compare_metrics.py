"""The metrics of several runs, each against the first: paired if they have scenarios in common."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

from recast.evaluation import COLUMNS, RolloutMetrics, TableRow, table
from recast.evaluation.same_script import script_difference
from recast.reporting.compare_inputs import ComparedRun, ScenarioKey, letter
from recast.reporting.inputs import NotMade, RolloutPart
from recast.reporting.moments import PATHS_APART, paths_part
from recast.reporting.summary import Outcome, outcome
from recast.reporting.tables import Cell, Line, aggregate_line, difference_line, digits
from recast.simulation.rollout import Rollout, RolloutFailure


@dataclass(frozen=True)
class ComparedOutcome:
    """How one rollout ended, and where its path leaves that of the first run; None if unknown."""

    outcome: Outcome
    path: str | None


@dataclass(frozen=True)
class OutcomeRow:
    """One scenario, planner and arm, and how it ended in every run."""

    title: str
    planner: str
    arm: str
    cells: tuple[ComparedOutcome, ...]


def same_scenario(one: Rollout, other: Rollout) -> bool:
    """Whether two rollouts had the same actor, route and start; their lengths may differ."""
    asked = replace(one, steps_requested=other.steps_requested)
    return script_difference(asked, other) is None


def metric_lines(runs: Sequence[ComparedRun]) -> tuple[Line, ...]:
    """Means by planner and arm, a line for each run, each followed by its difference to the first.

    The difference is over pairs of rollouts of the same scenario; without a pair it is that of the
    means, and the line says so.
    """
    lines: list[Line] = []
    arms = list(dict.fromkeys(arm for run in runs for arm in run.arms))
    planners = dict.fromkeys(planner for run in runs for _, _, planner in run.scenarios)
    for planner in planners:
        for arm in arms:
            lines += _lines_of(runs, planner, arm, arms.index(arm))
    return tuple(lines)


def outcome_rows(runs: Sequence[ComparedRun]) -> tuple[OutcomeRow, ...]:
    """A row for each scenario, planner and arm that any run has."""
    keys = dict.fromkeys(key for run in runs for key in run.scenarios)
    arms = {arm: title for run in reversed(runs) for arm, title in run.arms.items()}
    rows = []
    for key in keys:
        for arm in dict.fromkeys(arm for run in runs for arm in run.arms):
            parts = [_part(run, key, arm) for run in runs]
            if any(part is not None for part in parts):
                title = f"{key[0]}, setting {key[1]}".capitalize()
                cells = tuple(_compared(part, parts[0], i) for i, part in enumerate(parts))
                rows.append(OutcomeRow(title, key[2], arms[arm], cells))
    return tuple(rows)


def _lines_of(runs: Sequence[ComparedRun], planner: str, arm: str, colour: int) -> list[Line]:
    attempts = [_attempts(run, planner, arm) for run in runs]
    found: list[tuple[TableRow, Line] | None] = []
    for number, (scored, failed) in enumerate(attempts):
        rows = table(scored, failed)
        title = f"{letter(number)}: {runs[number].arms.get(arm, arm)}"
        found.append(
            (rows[0], aggregate_line(rows[0], {arm: title}, {arm: colour})) if rows else None
        )
    lines: list[Line] = []
    for number, one in enumerate(found):
        if one is None:
            continue
        lines.append(one[1])
        if number > 0 and found[0] is not None:
            title = f"{letter(number)} minus A"
            paired = _paired(attempts[0], attempts[number], title)
            lines.append(paired or _unpaired(found[0][0], one[0], title))
    return lines


_Attempts = tuple[list[RolloutMetrics], list[RolloutFailure]]


def _attempts(run: ComparedRun, planner: str, arm: str) -> _Attempts:
    parts = [_part(run, key, arm) for key in run.scenarios if key[2] == planner]
    there = [part for part in parts if part is not None]
    return (
        [part.metrics for part in there if not isinstance(part.metrics, NotMade)],
        [part.rollout for part in there if isinstance(part.rollout, RolloutFailure)],
    )


def _paired(first: _Attempts, other: _Attempts, title: str) -> Line | None:
    pairs = [
        (replace(a, arm="first"), replace(b, arm="other"))
        for a in first[0]
        for b in other[0]
        if (a.motion, a.setting) == (b.motion, b.setting) and same_scenario(a.rollout, b.rollout)
    ]
    scored = [metrics for pair in pairs for metrics in pair]
    line = difference_line(scored, (), {"first": "A", "other": "B"}, "other", "first")
    return None if line is None else replace(line, label=title, sub=f"paired; {line.sub}")


def _unpaired(first: TableRow, other: TableRow, title: str) -> Line:
    cells = []
    for key, column in COLUMNS.items():
        one, two = other.means[key], first.means[key]
        if one is None or two is None:
            cells.append(Cell("-"))
            continue
        unit = "points" if column.unit == "%" else column.unit
        cells.append(Cell(f"{one - two:+.{digits(key)}f}\u00a0{unit}"))
    return Line(title, None, tuple(cells), "difference of the means: no scenario in common")


def _part(run: ComparedRun, key: ScenarioKey, arm: str) -> RolloutPart | None:
    if key not in run.scenarios:
        return None
    return next((part for part in run.scenarios[key].rollouts if part.arm == arm), None)


def _compared(part: RolloutPart | None, first: RolloutPart | None, number: int) -> ComparedOutcome:
    if part is None:
        return ComparedOutcome(Outcome("not asked for", "plain"), None)
    if number == 0 or first is None:
        return ComparedOutcome(outcome(part), None)
    return ComparedOutcome(outcome(part), _path(first.rollout, part.rollout))


def _path(first: object, other: object) -> str | None:
    if not isinstance(first, Rollout) or not isinstance(other, Rollout):
        return None
    if not same_scenario(first, other):
        return "another scenario than A's: not compared"
    step = paths_part(first, other)
    if step is None:
        return f"path within {PATHS_APART:g} m of A's"
    return f"path leaves A's at {step * other.dt:.1f} s"
