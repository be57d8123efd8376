"""Several runs on one page: what they were asked, what they scored, where each one's arms part."""

from __future__ import annotations

import json
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import Any

from recast.logs.hdmap import HdMap
from recast.metrics import COLUMNS, RolloutMetrics, TableRow, table
from recast.metrics.table import script_difference
from recast.reporting.birdseye import Birdseye, MapLayer
from recast.reporting.inputs import NOT_MADE, NotMade, ReportInputs, RolloutPart, ScenarioPart
from recast.reporting.moments import PATHS_APART, Strip, moment_strip, paths_part
from recast.reporting.page import PageAssets, render_template, write_page
from recast.reporting.summary import RolloutOutcome, outcome
from recast.reporting.tables import Line, TableCell, aggregate_line, difference_line, digits
from recast.simulation.rollout import Rollout, RolloutFailure

ScenarioKey = tuple[str, str, str]
"""Motion, setting and planner."""

MISSING = "-"


@dataclass(frozen=True)
class ComparedRun:
    """One of the runs.

    Attributes:
        log: name of its log.
        log_hash: hash of the log's contents.
        settings: JSON-able members, nested as deep as one likes; those that differ are shown.
    """

    name: str
    log: str
    log_hash: str
    target: str
    arms: Mapping[str, str]
    scenarios: Mapping[ScenarioKey, ScenarioPart]
    settings: Mapping[str, Any] = field(default_factory=dict)
    hd_map: HdMap | NotMade = NOT_MADE
    camera_headings: Mapping[str, float] = field(default_factory=dict)


def letter(number: int) -> str:
    """What the `number`-th run is called on the page: A, B, ... Z, then 27, 28, ..."""
    return chr(ord("A") + number) if number < 26 else str(number + 1)


def write_comparison(runs: Sequence[ComparedRun], out: str | Path) -> Path:
    """Write a page that compares runs, the others with the first; return its `index.html`.

    The folder appears whole and asks for nothing from the network. The same runs give the same
    bytes.

    Raises:
        InputError: `out` holds something that is no report, or the disk is full.
        ValueError: fewer than two runs.
    """
    if len(runs) < 2:
        raise ValueError(f"runs: {len(runs)} given, expected at least 2")
    return write_page(out, lambda assets: _render(runs, assets))


def _render(runs: Sequence[ComparedRun], assets: PageAssets) -> str:
    titles = list({arm: title for run in reversed(runs) for arm, title in run.arms.items()}.items())
    order = list(dict.fromkeys(arm for run in runs for arm in run.arms))
    arms = {arm: dict(titles)[arm] for arm in order}
    return render_template(
        "compare.html",
        runs=[(letter(number), run) for number, run in enumerate(runs)],
        warnings=_warnings(runs),
        settings=differing_settings(runs),
        metrics=metric_lines(runs),
        outcomes=outcome_rows(runs),
        moments=[
            (letter(number), part.title, _strip(run, arms, letter(number), part, assets))
            for number, run in enumerate(runs)
            for part in run.scenarios.values()
        ],
        arms=list(arms.values()),
    )


def _warnings(runs: Sequence[ComparedRun]) -> tuple[str, ...]:
    """In which way the runs are not comparable, in sentences."""
    found = []
    first = runs[0]
    for number, run in enumerate(runs[1:], 1):
        if run.log_hash != first.log_hash:
            found.append(
                f"{letter(number)} is a run on another log than A ({run.log}, not {first.log}): "
                "its differences compare different scenes."
            )
        elif run.target != first.target:
            found.append(f"{letter(number)} has the target {run.target}, A has {first.target}.")
    missing = {
        letter(number): [
            f"{motion}, setting {setting}, {planner}"
            for motion, setting, planner in first.scenarios
            if (motion, setting, planner) not in run.scenarios
        ]
        for number, run in enumerate(runs[1:], 1)
    }
    found += [
        f"{name} does not have these scenarios: {'; '.join(keys)}."
        for name, keys in missing.items()
        if keys
    ]
    return tuple(found)


def _strip(
    run: ComparedRun, arms: dict[str, str], name: str, part: ScenarioPart, assets: PageAssets
) -> Strip:
    inputs = ReportInputs(run.name, run.log, arms, camera_headings=run.camera_headings)
    layer = MapLayer(run.hd_map if isinstance(run.hd_map, HdMap) else None)
    drawn = {
        one.arm: Birdseye(one.rollout, layer)
        for one in part.rollouts
        if isinstance(one.rollout, Rollout)
    }
    return moment_strip(inputs, f"{name}-{part.title}", part.rollouts, drawn, assets)


@dataclass(frozen=True)
class ComparedOutcome:
    """How one rollout ended, and where its path leaves that of the first run; None if unknown."""

    outcome: RolloutOutcome
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
            cells.append(TableCell("-"))
            continue
        unit = "points" if column.unit == "%" else column.unit
        cells.append(TableCell(f"{one - two:+.{digits(key)}f}\u00a0{unit}"))
    return Line(title, None, tuple(cells), "difference of the means: no scenario in common")


def _part(run: ComparedRun, key: ScenarioKey, arm: str) -> RolloutPart | None:
    if key not in run.scenarios:
        return None
    return next((part for part in run.scenarios[key].rollouts if part.arm == arm), None)


def _compared(part: RolloutPart | None, first: RolloutPart | None, number: int) -> ComparedOutcome:
    if part is None:
        return ComparedOutcome(RolloutOutcome("not requested", "plain"), None)
    if number == 0 or first is None:
        return ComparedOutcome(outcome(part), None)
    return ComparedOutcome(outcome(part), _path(first.rollout, part.rollout))


def _path(first: object, other: object) -> str | None:
    if not isinstance(first, Rollout) or not isinstance(other, Rollout):
        return None
    if not same_scenario(first, other):
        return "not compared: the scenario differs from A's"
    step = paths_part(first, other)
    if step is None:
        return f"path within {PATHS_APART:g} m of A's path"
    return f"path leaves A's path at {step * other.dt:.1f} s"


def differing_settings(runs: Sequence[ComparedRun]) -> tuple[tuple[str, tuple[str, ...]], ...]:
    """Dotted names of the settings that differ, each with its value in every run."""
    flat = [dict(_flattened(run.settings)) for run in runs]
    names = dict.fromkeys(name for one in flat for name in one)
    rows = ((name, tuple(one.get(name, MISSING) for one in flat)) for name in names)
    return tuple((name, values) for name, values in rows if len(set(values)) > 1)


def _flattened(value: Any, name: str = "") -> list[tuple[str, str]]:
    """Dotted names and values; a list of records with names counts as records by name."""
    if isinstance(value, Sequence) and not isinstance(value, str) and _all_named(value):
        value = {one["name"]: {k: v for k, v in one.items() if k != "name"} for one in value}
    if not isinstance(value, Mapping):
        return [(name, value if isinstance(value, str) else json.dumps(value, ensure_ascii=False))]
    return [
        pair
        for key, inner in value.items()
        for pair in _flattened(inner, f"{name}.{key}" if name else str(key))
    ]


def _all_named(values: Sequence[Any]) -> bool:
    return len(values) > 0 and all(isinstance(one, Mapping) and "name" in one for one in values)
