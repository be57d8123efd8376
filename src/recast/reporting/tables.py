"""Metric tables and the scores of a scene: what each number is, and how it is written."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from typing import Any, Literal

from recast.metrics import (
    COLUMNS,
    Metric,
    RolloutMetrics,
    TableRow,
    column_of,
    columns_of,
    matched_pairs,
    table,
)
from recast.metrics.plan_agreement import PlanAgreement
from recast.reporting.inputs import Fact, ImageScore, NotMade, ScenarioPart
from recast.simulation.rollout import RolloutFailure

Tone = Literal["good", "bad", "warn", "plain"]

DEFINITIONS: Mapping[str, str] = {
    "nc": "No collision: the ego's box never overlaps the actor's logged box, seen from above. "
    "Who is at fault does not matter.",
    "nc_at_fault": "No collision at fault: as no collision, but contacts while the ego stands, and "
    "those from behind, do not count.",
    "dac": "Drivable-area compliance: all four corners of the ego's box stay on the map's drivable "
    "area, with a tolerance of 0.3 m, in every state.",
    "ttc": "Time to collision: time until a plan, if followed, hits the actor on the actor's real "
    "path; the shortest time of all plans, capped at 4 s.",
    "r_c": "Route completion: distance driven before the first contact, divided by the length of "
    "the logged route ahead of the start.",
    "com": "Comfort of the plans: share of plans whose acceleration (-4.05 to 2.40 m/s²), jerk "
    "(8.37 m/s³), yaw rate (0.95 rad/s), yaw acceleration (1.93 rad/s²) and lateral acceleration "
    "(4.89 m/s²) stay within limits.",
    "com_driven": "Comfort of the driven path: nuPlan's six checks hold throughout the smoothed "
    "motion of the ego. A plan may begin with a jump that the controller never drives.",
    "no_phantom_braking": "No phantom braking: the ego never brakes with more than 3 m/s² over "
    "half a second where no actor ahead, or about to be, makes it.",
    "ttc_constant_velocity": "TTC if the actor goes on at constant velocity.",
    "r_c_projection": "Route completion by the ego's projection onto the route.",
    "com_4_13": "Comfort with nuPlan's limit on jerk, 4.13 m/s³.",
    "com_nuplan_savgol": "Comfort with nuPlan's six checks on smoothed signals.",
}
"""By key of `recast.metrics.COLUMNS`; higher is better for all."""
_SHORT_TTC = 1.0  # seconds: below, a driver hardly reacts
MOVING = "moving objects: boxes, length and width x 1.5"


@dataclass(frozen=True)
class TableCell:
    """One cell: the number with its unit, how it is to be taken, and what explains it.

    `size` is the magnitude of a difference, None for all else.
    """

    text: str
    tone: Tone = "plain"
    note: str | None = None
    size: float | None = None


@dataclass(frozen=True)
class Heading:
    """One column: label, definition, and whether it stands in the short table."""

    label: str
    definition: str
    headline: bool


@dataclass(frozen=True)
class Line:
    """One line: what it is about, an index of the arm's colour or None, and the cells."""

    label: str
    arm: int | None
    cells: tuple[TableCell, ...]
    sub: str | None = None


def headings(scenarios: Sequence[ScenarioPart] = ()) -> tuple[Heading, ...]:
    """Columns in the order of `recast.metrics.COLUMNS`, then own metrics of these rollouts."""
    return tuple(
        Heading(column.label, DEFINITIONS.get(key, "A metric of this run's own."), column.headline)
        for key, column in columns_of(_scored(scenarios)).items()
    )


def _scored(scenarios: Sequence[ScenarioPart]) -> list[RolloutMetrics]:
    return [
        part.metrics
        for scenario in scenarios
        for part in scenario.rollouts
        if not isinstance(part.metrics, NotMade)
    ]


def rollout_line(label: str, arm: int | None, metrics: RolloutMetrics) -> Line:
    """One rollout's metrics, each with the reason for its value."""
    return Line(
        label, arm, tuple(_rollout_cell(key, metric) for key, metric in metrics.values.items())
    )


def untoned(line: Line) -> Line:
    """The line of an arm that is not judged."""
    return replace(line, cells=tuple(replace(cell, tone="plain") for cell in line.cells))


def missing_line(label: str, arm: int | None, reason: str) -> Line:
    """A rollout without metrics."""
    cells = tuple(TableCell("-") for _ in COLUMNS)
    return Line(label, arm, cells, reason)


def aggregate_lines(
    scenarios: Sequence[ScenarioPart], arms: Mapping[str, str], truth: str | None = None
) -> tuple[Line, ...]:
    """Means by planner and arm, then differences over pairs of rollouts.

    Each arm minus the first; and, where one of them is the truth, each minus the truth: the gap
    to it, marked where it is the smallest. Pairs are compared over the steps that both have.
    """
    scored = _scored(scenarios)
    failures = [
        part.rollout
        for scenario in scenarios
        for part in scenario.rollouts
        if isinstance(part.rollout, RolloutFailure)
    ]
    order = {arm: i for i, arm in enumerate(arms)}
    rows = sorted(table(scored, failures), key=lambda row: order.get(row.arm, len(order)))
    lines = [aggregate_line(row, arms, order) for row in rows]
    judged = [arm for arm in arms if arm != truth]
    found = [difference_line(scored, failures, arms, m, judged[0]) for m in judged[1:]]
    lines += [line for line in found if line is not None]
    if truth is not None:
        gaps = [difference_line(scored, failures, arms, arm, truth) for arm in judged]
        lines += _nearest_marked([line for line in gaps if line is not None])
    return tuple(lines)


def _nearest_marked(gaps: Sequence[Line]) -> list[Line]:
    """Lines of gaps to the truth, the smallest of each column in the tone "good"."""
    marked = [list(line.cells) for line in gaps]
    for column in range(len(gaps[0].cells) if len(gaps) > 1 else 0):
        sizes = [line.cells[column].size for line in gaps]
        known = [size for size in sizes if size is not None]
        if len(known) == len(gaps) and min(known) < max(known):
            best = sizes.index(min(known))
            marked[best][column] = replace(marked[best][column], tone="good")
    return [
        replace(line, cells=tuple(cells), sub=f"gap to the truth; {line.sub}")
        for line, cells in zip(gaps, marked, strict=True)
    ]


def _rollout_cell(key: str, metric: Metric) -> TableCell:
    if metric.value is None:
        return TableCell("-", "plain", metric.reason)
    tone: Tone = "plain"
    if column_of(key).passes:
        passed = metric.value == 1.0
        return TableCell("pass" if passed else "fail", "good" if passed else "bad", metric.reason)
    if key.startswith("ttc"):
        tone = "bad" if metric.value == 0.0 else "warn" if metric.value < _SHORT_TTC else "plain"
    return TableCell(_number(key, column_of(key).scale * metric.value), tone, metric.reason)


def aggregate_line(row: TableRow, arms: Mapping[str, str], order: Mapping[str, int]) -> Line:
    """Means of one planner and arm; `arms` names arms for people, `order` indexes their colours."""
    cells = []
    for key, mean in row.means.items():
        count = row.counts[key]
        if mean is None:
            cells.append(TableCell("-"))
        elif column_of(key).passes:
            cells.append(
                TableCell(f"{round(mean * count / 100)} of {count}", "plain", f"{mean:.0f} %")
            )
        elif count < row.rollouts:
            cells.append(TableCell(_number(key, mean), note=f"over {count} of {row.rollouts}"))
        else:
            cells.append(TableCell(_number(key, mean)))
    sub = f"{row.planner}; {row.rollouts} of {_counted(row.asked, 'rollout')} scored"
    sub += f", {_counted(row.plans, 'plan')}"
    sub += f", {row.cut} cut short" if row.cut else ""
    sub += f", {row.failed} failed" if row.failed else ""
    return Line(arms.get(row.arm, row.arm), order.get(row.arm), tuple(cells), sub)


def difference_line(
    scored: Sequence[RolloutMetrics],
    failures: Sequence[RolloutFailure],
    arms: Mapping[str, str],
    candidate: str,
    baseline: str,
) -> Line | None:
    """Mean difference over the pairs of two arms; None without a pair."""
    pairs = matched_pairs({"": scored}, candidate, baseline, {"": failures})
    if not pairs.by_scene:
        return None
    most, cells = len(pairs.by_scene[""]), []
    for key, column in columns_of(scored).items():
        found = pairs.of(key)
        if found.pairs == 0:
            cells.append(TableCell("-"))
            continue
        unit = "points" if column.unit == "%" else column.unit
        difference = column.scale * float(found.differences[""].mean())
        text = f"{difference:+.{digits(key)}f}\u00a0{unit}".rstrip()
        note = f"over {found.pairs} of {_counted(most, 'pair')}" if found.pairs < most else None
        cells.append(TableCell(text, note=note, size=abs(round(difference, digits(key)))))
    compared = pairs.by_scene[""]
    sub = f"mean over {len(compared)} of {_counted(pairs.asked, 'pair')}"
    sub += f", {_counted(sum(pair.plans for pair in compared), 'plan')} each"
    cut = sum(pair.cut for pair in compared)
    sub += f", {cut} compared only up to a cut" if cut else ""
    return Line(f"{arms[candidate]} minus {arms[baseline]}", None, tuple(cells), sub)


def _number(key: str, value: float) -> str:
    return f"{value:.{digits(key)}f}\u00a0{column_of(key).unit}".rstrip()


def _counted(count: int, noun: str) -> str:
    return f"{count} {noun}" if count == 1 else f"{count} {noun}s"


def digits(key: str) -> int:
    """Digits behind the point of a metric, a key of `COLUMNS`, in its column's unit."""
    return 1 if column_of(key).unit == "%" else 2


def score_lines(evaluation: Mapping[str, Any]) -> tuple[ImageScore, ...]:
    """Held-out images: whole, what moves, and inside the box of each track.

    Args:
        evaluation: the contents of eval.json; see `SceneEvaluation.to_json`.
    """
    frames = evaluation["frames"]
    lines = [ImageScore("whole image", evaluation["psnr"], len(frames), evaluation["ssim"])]
    moving = evaluation["moving"]
    if moving is not None:
        seen = sum(frame["moving"] is not None for frame in frames)
        lines.append(ImageScore(MOVING, moving["psnr"], seen, moving["ssim"]))
    for track, value in evaluation["box_psnr_by_track"].items():
        seen = sum(track in frame["boxes"] for frame in frames)
        lines.append(ImageScore(f"inside the box of track {track}", value, seen))
    return tuple(lines)


def depth_facts(evaluation: Mapping[str, Any]) -> tuple[Fact, ...]:
    """The scene's depth against the LiDAR; nothing where the log has no sweep at these images.

    Args:
        evaluation: the contents of eval.json; see `SceneEvaluation.to_json`.
    """
    depth = evaluation["depth"]
    if depth is None:
        return ()
    seen = sum(frame["depth"] is not None for frame in evaluation["frames"])
    return (
        Fact("Median error", f"{depth['median_abs_m']:.3f} m", f"{seen} images"),
        Fact(
            "Mean error",
            f"{depth['mean_abs_m']:.2f} m",
            f"{100 * depth['mean_relative']:.1f} % of the distance",
        ),
        Fact(
            "No surface",
            f"{100 * depth['missing']:.1f} %",
            f"of {depth['points']:,} points, measured {depth['lag_ms']:.0f} ms from the image",
        ),
    )


def agreement_cells(found: PlanAgreement) -> tuple[list[str], list[list[str]]]:
    """Headings and rows of a plan agreement."""
    names = ["images", "n", "PSNR", "ADE m", "FDE m", "moved %", "other %"]
    detects = bool(found.moments[0].boxes)
    names += ["boxes %"] if detects else []
    rows = []
    for one in found.table:
        name = one.images if one.kind == "all" else f"{one.images}, {one.kind}"
        row = [name, str(one.moments), "-" if one.psnr is None else f"{one.psnr:.1f}"]
        row += [f"{one.ade:.2f}", f"{one.fde:.2f}"]
        row += [f"{100 * one.moved:.0f}", f"{100 * one.other_decision:.0f}"]
        row += ["-" if one.boxes is None else f"{100 * one.boxes:.0f}"] if detects else []
        rows.append(row)
    return names, rows


def agreement_lead(found: PlanAgreement) -> str:
    """What was found, in a sentence."""
    said = [
        f"{one.moved:.0%} {arm}" for arm in found.arms if (one := found.scores(arm)) is not None
    ]
    left = f" {found.left_out} moments without all images were left out." if found.left_out else ""
    return (
        f"At {len(found.moments)} moments the plans of {found.planner} on rendered images end more "
        f"than 2 m from those on the recorded ones in: {', '.join(said)}. A shift of the recorded "
        f"images by one pixel moves {found.floor:.0%}.{left}"
    )
