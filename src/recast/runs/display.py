"""Progress bars and tables of `recast run` for the terminal."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import Any

from rich.box import SIMPLE_HEAD
from rich.console import Console
from rich.progress import BarColumn, MofNCompleteColumn, TaskID, TextColumn, TimeRemainingColumn
from rich.table import Table
from rich.text import Text

from recast.actors import Actor
from recast.actors.actor import CandidateRecord
from recast.core.diagnostics import Bars
from recast.core.errors import printable
from recast.metrics import COLUMNS, OracleViews


class SamplingProgress(Bars):
    """One progress bar for each sampling stage; call it with stage, finished and all steps."""

    def __init__(self, console: Console) -> None:
        super().__init__(
            TextColumn("  {task.description}"),
            BarColumn(),
            MofNCompleteColumn(),
            TimeRemainingColumn(),
            console=console,
        )
        self._tasks: dict[str, TaskID] = {}

    def __call__(self, stage: str, done: int, total: int) -> None:
        """Set the finished and all steps of a stage; a repeated stage starts again at zero."""
        if stage not in self._tasks:
            self._tasks[stage] = self._bars.add_task(stage, total=total)
        self._bars.update(self._tasks[stage], completed=done, total=total)


def print_actor(actor: Actor, console: Console) -> None:
    """Print the chosen vehicle, its registration, and warnings that need a person's eye."""
    provenance = actor.provenance
    for warning in provenance.mask.warnings():
        console.print(f"warning: {warning}", markup=False, style="yellow")
    if len(provenance.candidates) > 1:
        console.print(candidates_table(provenance.candidates))
    for one in provenance.candidates:
        if one.chosen and one.score is not None and not one.score.fits:
            console.print(
                "warning: no candidate matches the shape in masks and LiDAR; the best candidate "
                f"is used ({one.generator}, {one.label})",
                markup=False,
                style="yellow",
            )
    console.print(provenance.registration.explain(), markup=False, highlight=False)


def narrow_table(
    title: str | Text | None, words: Sequence[str] = (), figures: Sequence[str] = ()
) -> Table:
    """A table for 80 columns: words on the left, figures on the right.

    Where a line is too long, only the first column gives way.
    """
    table = Table(
        title=title, title_justify="left", box=SIMPLE_HEAD, collapse_padding=True, pad_edge=False
    )
    for heading in words:
        table.add_column(heading, overflow="fold", no_wrap=heading != words[0])
    for heading in figures:
        table.add_column(heading, no_wrap=True, justify="right")
    return table


def candidates_table(candidates: Sequence[CandidateRecord]) -> Table:
    """Table of the candidate vehicles of an actor with their scores; 80 columns wide."""
    table = narrow_table("candidates")
    for heading in ("", "generator", "which", "outline", "LiDAR", "free", "colour", "score"):
        table.add_column(heading)
    for one in candidates:
        table.add_row("*" if one.chosen else "", *(Text(cell) for cell in one.cells()))
    return table


def results_tables(rows: Sequence[Mapping[str, Any]]) -> list[Table]:
    """One table for each planner: headline metrics by arm; 80 columns wide."""
    planners = dict.fromkeys(row["planner"] for row in rows)
    return [_results(planner, [r for r in rows if r["planner"] == planner]) for planner in planners]


def _results(planner: str, rows: Sequence[Mapping[str, Any]]) -> Table:
    headline = {name: column for name, column in COLUMNS.items() if column.headline}
    headings = [column.heading for column in headline.values()]
    title = Text(f"{printable(planner)} in closed loop")
    table = narrow_table(title, ["arm", "scored", "plans", *headings])
    for row in rows:
        told = [f"{row['rollouts']} of {row['asked']}"]
        told += [f"{row[what]} {what}" for what in ("failed", "cut") if row[what]]
        table.add_row(
            Text(printable(row["arm"])),
            "\n".join(told),
            str(row["plans"]),
            *(_mean(row, name) for name in headline),
        )
    return table


def failure_lines(failures: Sequence[Mapping[str, Any]]) -> list[str]:
    """One line for each reason in `failures` of metrics.json, with the number of its rollouts."""
    reasons: dict[str, list[str]] = {}
    for one in failures:
        # A refusal names the rollout, which is another one for every arm.
        reason = str(one["reason"]).replace(f"rollout {one['name']}: ", "")
        reasons.setdefault(reason, []).append(one["name"])
    return [
        f"{names[0]}{f' and {len(names) - 1} more' if names[1:] else ''}: {reason}"
        for reason, names in reasons.items()
    ]


def _mean(row: Mapping[str, Any], name: str) -> str:
    """The mean of a metric, and the number of its rollouts if some have no value."""
    value, count = row["means"][name], row["counts"][name]
    if value is None:
        return "n/a"
    return f"{value:.2f}" if count == row["rollouts"] else f"{value:.2f}\nof {count}"


def truth_table(views: OracleViews) -> Table:
    """Table of the vehicle's scores against the truth, by angle from the nearest logged view."""
    table = Table(
        title="actor's box against the truth: street's own actor → generated actor",
        title_justify="left",
        box=SIMPLE_HEAD,
    )
    for heading in ("degrees from the log", "views", "PSNR dB", "SSIM", "mask IoU"):
        table.add_column(heading, no_wrap=True)
    for row in views.summary:
        if row.baseline is None or row.candidate is None:
            continue
        values = (
            f"{getattr(row.baseline, name):.{digits}f} → {getattr(row.candidate, name):.{digits}f}"
            for name, digits in (("psnr", 2), ("ssim", 3), ("mask_iou", 2))
        )
        table.add_row(f"{row.low:.0f}-{row.high:.0f}", str(row.views), *values)
    return table
