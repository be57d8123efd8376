"""What a search writes and prints: results, a table of its trials, scenario files, a page."""

from __future__ import annotations

from collections.abc import Sequence
from itertools import groupby
from pathlib import Path
from typing import Any

import numpy as np
import pyarrow as pa
import yaml
from rich.console import Console

from recast.core import files, open_store
from recast.core.errors import printable
from recast.core.files import folder_name
from recast.core.table_files import write_parquet
from recast.metrics.table import rounded
from recast.reporting import drawing
from recast.reporting.page import render_template
from recast.reporting.plots import INK, Figure, Plot
from recast.runs.display import narrow_table
from recast.runs.run import run
from recast.runs.run_folder import STORE_FOLDER
from recast.studies.boundary import (
    TRIALS_FILE,
    BoundaryDistance,
    LineAnswer,
    SearchAnswers,
    StudyComparison,
    along,
    contour,
    counted_words,
    is_fair,
    search_rows,
    sentence,
)
from recast.studies.designs import Axis, Design, telling
from recast.studies.scene_run import log_artefact, open_scene
from recast.studies.search import (
    SEARCH_FORMAT,
    SEARCH_VERSION,
    SearchResults,
    told_point,
)
from recast.studies.study_database import SearchLine, Trial

RESULTS_FILE, PAGE_FILE = "results.json", "index.html"
SCENARIOS_FOLDER, REPORTS_FOLDER = "scenarios", "reports"


def write_search(found: SearchAnswers, out: Path) -> None:
    """Write what a search found.

    `results.json` has the rows of `search_rows`; `trials.parquet` every trial; `scenarios/` the
    mildest failure and the hardest success of each line as scenario files, which `recast run
    --motion` takes; `index.html` shows it all.
    """
    results = found.results
    record = {"format": SEARCH_FORMAT, "version": SEARCH_VERSION, **search_rows(found)}
    files.write_json(out / RESULTS_FILE, rounded(record))
    write_parquet(out / TRIALS_FILE, _table(results))
    for number, one in enumerate(found.lines):
        for which, words in EXAMPLES.items():
            trial = getattr(one, which)
            if trial is not None:
                scenario = results.settings.scenario(one.line.motion, trial.point, words)
                path = out / scenario_file(number, one.line, which)
                path.parent.mkdir(exist_ok=True)
                text = yaml.safe_dump(scenario, sort_keys=False, allow_unicode=True)
                files.write_text(path, text)
    write_page(found, out)


def write_page(found: SearchAnswers, out: Path) -> None:
    """Write `index.html`, which links the reports that are there by now."""
    page = render_template("search.html", search=_view(found, out))
    files.write_text(out / PAGE_FILE, page)


def report_examples(
    found: SearchAnswers, out: Path, console: Console, store: str | Path | None = None
) -> None:
    """Drive the examples of every log again, with films and a report: `reports/LOG/report`.

    Of each motion and planner those of one arm, the first that replaces the vehicle, or else the
    first: all arms drive them. The page of `write_search` shows reports that are there.

    Raises:
        InputError: see `recast.runs.run.run`.
    """
    settings = found.results.settings
    bench = settings.bench
    place = open_store(str(out.absolute().parent / STORE_FOLDER if store is None else store))
    arm = next((one.name for one in bench.run.arms if one.generates), bench.run.arms[0].name)
    for scene in bench.scenes:
        own: dict[str, dict[str, Any]] = {}
        for one in found.lines:
            if one.line.scene != scene.id or one.line.arm != arm:
                continue
            number = 1 + bench.run.planners.index(one.line.planner)
            for which, words in EXAMPLES.items():
                trial = getattr(one, which)
                if trial is not None:
                    setting = words if len(bench.run.planners) == 1 else f"{words}-{number}"
                    record = settings.scenario(one.line.motion, trial.point, setting)
                    own[f"{record['name']}-{setting}"] = record
        if not own:
            continue
        log = log_artefact(place, scene, bench) if scene.log is None else None
        source, config = open_scene(scene, bench, log)
        update: dict[str, Any] = {"motions": tuple(own), "own_motions": own}
        update |= {"films": True, "end_on_contact": False}
        target = out / REPORTS_FOLDER / folder_name(scene.id)
        run(source.path, target, config.model_copy(update=update), console, str(place.root))


EXAMPLES = {"mildest": "mildest-failure", "hardest": "hardest-success"}
"""Settings that scenario files of a line's examples have."""


def scenario_file(number: int, line: SearchLine, which: str) -> str:
    """Where the scenario of an example of the line of a number lies in the study's folder."""
    return f"{SCENARIOS_FOLDER}/{number:03d}-{folder_name(line.arm)}-{which}.yaml"


def _table(results: SearchResults) -> pa.Table:
    """A row for each trial: line, values, margin, measures, what it asks of a driver."""
    axes = results.settings.design.axes
    rows = []
    for line, trials in results.lines.items():
        for one in trials:
            result = one.result or {}
            driver = result.get("driver") or {}
            rows.append(
                {
                    **vars(line),
                    "trial": one.index,
                    **dict(zip((axis.name for axis in axes), one.point, strict=True)),
                    "margin": one.margin,
                    **{f"metric_{k}": v for k, v in (result.get("measures") or {}).items()},
                    **{f"driver_{k}": v for k, v in driver.items()},
                    "rollout": result.get("rollout"),
                    "failure": result.get("failure"),
                    "refused": result.get("refused"),
                }
            )
    names = dict.fromkeys(name for row in rows for name in row)
    return pa.table({name: [row.get(name) for row in rows] for name in names})


def print_search(found: SearchAnswers, console: Console) -> None:
    """Print a line for each log, motion, planner and arm, and the distances from the truth."""
    design = found.results.settings.design
    for one in found.lines:
        words = f"{one.line.scene}, {one.line.motion}, {one.line.planner}, {one.line.arm}: "
        console.print(printable(words + sentence(one, design.axes)), markup=False)
        console.print(f"  {_counted(one, design.axes)}", markup=False, highlight=False)
    for scene, reason in found.results.failed.items():
        console.print(printable(f"{scene}: {reason}"), markup=False, style="red")
    if not found.distances:
        return
    axis = design.axes[along(design.axes)]
    title = f"boundary along {axis.name}: distance from the truth's, {axis.unit}"
    table = narrow_table(title, ["arm"], ["distance", "shift", "other\nverdict", "rows"])
    for distance in found.distances:
        arm, planner, motion, *cells = _distance_cells(distance)
        shown = (cell.replace(" (", "\n(") for cell in cells)
        table.add_row(f"{arm}\n{planner}, {motion}", *shown)
    console.print(table)


def print_comparison(found: StudyComparison, design: Design, console: Console) -> None:
    """Print which failures are new and which are gone."""
    words = f"{found.common} trials in both studies: {len(found.new)} failures new, "
    console.print(f"{words}{len(found.gone)} gone", markup=False, highlight=False)
    for kind, trials in (("new", found.new), ("gone", found.gone)):
        for line, trial in trials[:_SHOWN]:
            told = f"  {kind}: {line.name}, {told_point(design.axes, trial.point)}"
            console.print(printable(told), markup=False, highlight=False)
        if len(trials) > _SHOWN:
            console.print(f"  and {len(trials) - _SHOWN} more {kind}", markup=False)


_SHOWN = 5


def _distance_cells(one: BoundaryDistance) -> list[str]:
    logs = "1 log" if one.scenes == 1 else f"{one.scenes} logs"
    over = "" if one.scenes == 1 else " ({:.2f} to {:.2f})"
    return [
        one.arm,
        one.planner,
        one.motion,
        f"{one.distance.point:.2f}" + over.format(one.distance.low, one.distance.high),
        f"{one.shift.point:+.2f}" + over.format(one.shift.low, one.shift.high),
        "n/a" if one.differs is None else f"{100 * one.differs:.1f} %",
        f"{one.rows} ({logs})",
    ]


def _counted(one: LineAnswer, axes: Sequence[Axis]) -> str:
    words = counted_words(one)
    region = "scenarios, as often as they occur," if any(axis.occurs for axis in axes) else "region"
    if one.share is not None:
        point, low, high = (100 * value for value in one.share)
        words += f"; {point:.0f} % of the {region} fail ({low:.0f} to {high:.0f} %)"
    return words


def _view(found: SearchAnswers, out: Path) -> dict[str, Any]:
    """What search.html shows."""
    settings = found.results.settings
    axes = settings.design.axes
    first = along(axes)
    axis = axes[first]

    def group(one: LineAnswer) -> tuple[str, str, str]:
        return one.line.scene, one.line.motion, one.line.planner

    groups = []
    for (scene, motion, planner), lines in groupby(found.lines, group):
        answers = list(lines)
        report = f"{REPORTS_FOLDER}/{folder_name(scene)}/report/index.html"
        groups.append(
            {
                "title": f"{planner}, {motion}, {scene}",
                "report": report if (out / report).is_file() else None,
                "arms": [
                    {
                        "name": one.line.arm,
                        "sentence": sentence(one, axes),
                        "counted": _counted(one, axes),
                        "examples": [
                            (
                                words.replace("-", " "),
                                told_point(axes, trial.point),
                                _told(trial),
                                scenario_file(found.lines.index(one), one.line, key),
                            )
                            for key, words in EXAMPLES.items()
                            if (trial := getattr(one, key)) is not None
                        ],
                    }
                    for one in answers
                ],
                "plots": [
                    _plot(one, number, answers, settings.design)
                    for number, one in enumerate(answers)
                ],
                "rows": _rows(answers, axes),
            }
        )
    others = [one.name for i, one in enumerate(axes) if i != first]
    return {
        "title": f"Where {', '.join(settings.bench.run.planners)} begins to fail",
        "lead": _lead(found),
        "groups": groups,
        "row_names": [*others, *(arm.name for arm in settings.bench.run.arms)],
        "along": f"{axis.name} {axis.unit}".strip(),
        "distances": [_distance_cells(one) for one in found.distances],
        "failed": dict(found.results.failed),
    }


def _lead(found: SearchAnswers) -> str:
    settings = found.results.settings
    over = " and ".join(f"{axis.name} {axis.told}" for axis in settings.design.axes)
    trials = sum(len(trials) for trials in found.results.lines.values())
    return (
        f"{trials} trials of {', '.join(settings.bench.run.motions)} over {over}. "
        f"It fails by: {settings.objective.text}."
    )


def _told(trial: Trial) -> str:
    """What happened in a trial, and what its scenario asks of a driver."""
    result = trial.result or {}
    measures, driver = result.get("measures") or {}, result.get("driver") or {}
    words = []
    if measures.get("contact_speed"):
        words.append(f"contact at {measures['contact_speed']:.1f} m/s")
    elif measures.get("distance") is not None:
        words.append(f"{measures['distance']:.1f} m apart at least")
    if driver.get("braking") is not None:
        words.append(f"a driver brakes with {driver['braking']:g} m/s2")
    elif driver.get("lane_change"):
        words.append("a driver changes the lane")
    return ", ".join(words)


def _rows(answers: Sequence[LineAnswer], axes: Sequence[Axis]) -> list[list[str]]:
    """The boundary, a row for each place along the other settings, a column for each arm."""
    rows: dict[tuple[float, ...], dict[str, list[str]]] = {}
    for one in answers:
        for crossing in one.crossings:
            told = f"{crossing.value:.2f} ({crossing.low:.2f} to {crossing.high:.2f})"
            by_arm = rows.setdefault(crossing.others, {})
            by_arm.setdefault(one.line.arm, []).append(told)
    return [
        [
            *(f"{value:.3g}" for value in others),
            *("; ".join(rows[others].get(one.line.arm, ["none"])) for one in answers),
        ]
        for others in sorted(rows)
    ]


_MOST_DRAWN = 1500
"""Trials that a plot shows at most, so that a page of very many opens."""


def _drawn(told: Sequence[Trial]) -> Sequence[Trial]:
    if len(told) <= _MOST_DRAWN:
        return told
    numbered = [((float(i),), trial.margin or 0.0) for i, trial in enumerate(told)]
    return [told[int(place[0])] for place, _ in telling(numbered, _MOST_DRAWN)]


_GOOD, _BAD = "#2a9d63", "#d03a3a"


def _plot(one: LineAnswer, number: int, answers: Sequence[LineAnswer], design: Design) -> Plot:
    """The region of a line: trials, its boundary, and those of the other arms, thin."""
    axes = design.axes
    first = along(axes)
    axis, others = axes[first], [a for i, a in enumerate(axes) if i != first]
    second = others[0] if others else None
    label = f"{axis.name} [{axis.unit}]"
    if second is None:
        margins = [one.margin or 0.0 for one in one.trials] or [0.0]
        figure = Figure(
            axis.high, min(-1.0, *margins), max(1.0, *margins), "margin", label, None, axis.low
        )
    else:
        name = f"{second.name} [{second.unit}]"
        figure = Figure(axis.high, second.low, second.high, name, label, None, axis.low)

    def place(trial: Trial) -> tuple[float, float]:
        y = (trial.margin or 0.0) if second is None else trial.point[axes.index(second)]
        return trial.point[first], y

    told = _drawn([trial for trial in (*one.trials, *one.unfair) if trial.margin is not None])
    for fails in (False, True):
        for fair in (True, False):
            chosen = [t for t in told if ((t.margin or 0) < 0) == fails and is_fair(t) == fair]
            if chosen:
                x, y = np.array([place(t) for t in chosen]).T
                figure.dots(x, y, _BAD if fails else _GOOD, 3.5, hollow=not fair)
    for other, answer in enumerate(answers):
        colour = drawing.css(drawing.arm_colour(other))
        width, dash = (2.4, "") if other == number else (1.2, "4 3")
        if second is None:
            for crossing in answer.crossings:
                figure.line([crossing.value] * 2, [figure.low, figure.high], colour, width, dash)
        elif answer.field is not None:
            for piece in contour(answer.field, design, first, axes.index(second)):
                figure.line(piece[:, 0], piece[:, 1], colour, width)
        else:
            for crossing in answer.crossings:  # of bisections
                row = [crossing.others[0]] * 2
                figure.line([crossing.low, crossing.high], row, colour, width)
    if second is None:
        figure.line([axis.low, axis.high], [0.0, 0.0], INK, 1.0, "2 3")
    title = f"{one.line.arm}"
    return figure.plot(title, f"{sentence(one, axes)}; {counted_words(one)}")
