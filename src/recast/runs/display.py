"""What the steps of a run show on a terminal: progress, tables, and the judging of a scene."""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from contextlib import ExitStack
from functools import partial
from pathlib import Path
from typing import Any

import numpy as np
from rich import get_console
from rich.box import SIMPLE_HEAD
from rich.console import Console, RenderableType
from rich.markup import escape
from rich.progress import (
    BarColumn,
    MofNCompleteColumn,
    Progress,
    TaskID,
    TextColumn,
    TimeRemainingColumn,
)
from rich.table import Table
from rich.text import Text

from recast.actors import Actor
from recast.actors.actor import CandidateRecord
from recast.arrays import Image
from recast.core.diagnostics import Bars, ProgressBar, draws
from recast.core.errors import printable
from recast.logs import DrivingLog
from recast.metrics import Column, OracleViews, headlines
from recast.metrics.perceptual import load_distances
from recast.reconstruction import (
    SHIFTS,
    RegionScore,
    SceneConfig,
    SceneEvaluation,
    ShiftedView,
    ShiftScores,
    TrainingStatus,
    evaluate_scene,
    read_training_config,
    require_log_of,
)
from recast.scene import load_scene
from recast.scene.exchange import IMPORT_FILE
from recast.synthetic import Oracle, is_synthetic, world_of
from recast.synthetic.world import sensor_number
from recast.synthetic.write import OraclePool


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
    for warning in provenance.warnings():
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
    """Tables of each planner: headline metrics by arm, and own metrics; 80 columns wide."""
    planners = dict.fromkeys(row["planner"] for row in rows)
    found = {planner: [r for r in rows if r["planner"] == planner] for planner in planners}
    return [
        _results(planner, mine, columns)
        for planner, mine in found.items()
        for columns in headlines(mine[0]["means"])
    ]


def _results(
    planner: str, rows: Sequence[Mapping[str, Any]], headline: Mapping[str, Column]
) -> Table:
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
        title="actor's box against the truth, by degrees from the log's views: "
        "street's own actor → generated actor",
        title_justify="left",
        box=SIMPLE_HEAD,
    )
    for heading in ("degrees", "views", "PSNR dB", "SSIM", "mask IoU", "sharpness"):
        table.add_column(heading, no_wrap=True)
    for row in views.summary:
        if row.baseline is None or row.candidate is None:
            continue
        values = (
            f"{getattr(row.baseline, name):.{digits}f} → {getattr(row.candidate, name):.{digits}f}"
            for name, digits in (("psnr", 2), ("ssim", 3), ("mask_iou", 2), ("sharpness", 2))
        )
        table.add_row(f"{row.low:.0f}-{row.high:.0f}", str(row.views), *values)
    return table


_STREAM = 801


class TrainingDisplay(Progress):
    """A live bar with a line of figures; pass the object itself as `progress` to `train_scene`.

    >>> from recast.reconstruction import train_scene
    >>> with TrainingDisplay() as display:                      # doctest: +SKIP
    ...     train_scene(log, out, config, progress=display)
    """

    def __init__(self, console: Console | None = None) -> None:
        columns = BarColumn(), MofNCompleteColumn(), TimeRemainingColumn()
        self._figures = Text()
        console = console or get_console()
        super().__init__(
            "{task.description}",
            *columns,
            console=console,
            refresh_per_second=4,
            disable=not draws(console),
        )
        self._task = self.add_task("scene", total=None)

    def __call__(self, status: TrainingStatus) -> None:
        """Show a status."""
        self._figures = Text("  " + describe(status), style="dim")
        self.update(
            self._task,
            description=f"scene: {status.phase}",
            total=status.iterations,
            completed=status.iteration,
        )

    def stop(self) -> None:
        """Stop drawing; where no bar can move, the last figures are one line."""
        super().stop()
        task = self.tasks[0]
        if self.disable and task.completed:
            said = f"  {task.description} {task.completed:g}/{task.total:g}"
            self.console.print(said + str(self._figures), markup=False, highlight=False)

    def get_renderables(self) -> Iterator[RenderableType]:
        """The bar, and the figures below it."""
        yield from super().get_renderables()
        yield self._figures


def describe(status: TrainingStatus) -> str:
    """One line of figures: those that are known."""
    parts = [f"{status.gaussians:,} Gaussians"] if status.gaussians else []
    if status.limited:
        parts.append(f"limit of {status.most_gaussians:,} met")
    if status.loss is not None:
        parts.append(f"loss {status.loss:.4f}")
    if status.psnr is not None:
        parts.append(f"train {status.psnr:.2f} dB")
    if status.held_out_psnr is not None:
        parts.append(f"held out {status.held_out_psnr:.2f} dB")
    if status.iterations_per_second is not None:
        parts.append(f"{status.iterations_per_second:.1f} it/s")
    if status.seconds_left is not None:
        minutes, seconds = divmod(round(status.seconds_left), 60)
        parts.append(f"{minutes}:{seconds:02d} left")
    return ", ".join(parts)


def evaluate_and_print(
    scene: str | Path,
    log: DrivingLog,
    out: str | Path,
    console: Console | None = None,
    *,
    shifts: bool = False,
    lpips: Path | None = None,
    workers: int = 0,
) -> SceneEvaluation:
    """Score a scene's held-out images, write eval.json and pictures, print tables.

    A scene that another program trained is scored on the images that ours would keep by default.

    Args:
        workers: processes that render the truth; 0 for one for each core.
        shifts: also views from beside the drive, `recast.reconstruction.SHIFTS`: against the truth
            where the log is synthetic, else as pictures alone.

    Raises:
        InputError: scene or weights are at fault, no image was held out, or another version of
            recast made the synthetic log.
    """
    console = console or Console()
    distances = load_distances(lpips=lpips)
    imported = (Path(scene) / IMPORT_FILE).is_file()
    config = SceneConfig() if imported else read_training_config(scene)
    require_log_of(scene, log)
    loaded = load_scene(scene)
    with ExitStack() as stack:
        truth = None
        if shifts and is_synthetic(log):
            truth = partial(shifted_truth, stack.enter_context(OraclePool(world_of(log), workers)))
        progress = stack.enter_context(ProgressBar("views", console, 1))
        evaluation = evaluate_scene(
            loaded,
            log,
            config,
            out,
            lpips=distances[0] if distances else None,
            shifts=SHIFTS if shifts else (),
            truth=truth,
            progress=progress,
        )
    console.print(evaluation_table(evaluation))
    if evaluation.shifts:
        console.print(shift_table(evaluation))
    if evaluation.shifts and not evaluation.shift_truth:
        console.print("shifted views: there is no ground truth, so they are images without scores")
    console.print(f"images: {out}", markup=False)
    return evaluation


def evaluation_table(evaluation: SceneEvaluation) -> Table:
    """Held-out scores, and a last line for the depth."""
    with_lpips = evaluation.lpips is not None
    table = _table("held-out images", "region", with_lpips)
    frames = len(evaluation.frames)
    table.add_row("whole image", str(frames), *_cells(evaluation.whole, with_lpips))
    if evaluation.moving is not None:
        seen = sum(frame.moving is not None for frame in evaluation.frames)
        cells = _cells(evaluation.moving, with_lpips)
        table.add_row("moving objects: boxes, l and w x1.5", str(seen), *cells)
    for track, value in evaluation.box_psnr_by_track().items():
        seen = sum(track in frame.boxes for frame in evaluation.frames)
        table.add_row(f"box of track {escape(printable(track))}", str(seen), f"{value:.2f}")
    if evaluation.box_psnr is not None:
        table.add_row("all boxes", str(frames), f"{evaluation.box_psnr:.2f}")
    depth = evaluation.depth
    if depth is not None:
        table.caption = (
            f"LiDAR depth: median error {depth.median_abs_m:.3f} m, mean {depth.mean_abs_m:.2f} m, "
            f"{100 * depth.mean_relative:.1f} %; no surface at {100 * depth.missing:.1f} % of "
            f"{depth.points:,} points, measured {depth.lag_ms:.0f} ms from the image"
        )
        table.caption_justify = "left"
    return table


def shift_table(evaluation: SceneEvaluation) -> Table:
    """Views as logged and beside the drive, a line for each shift of the ego: against the truth,
    where it is known, and what they show that the log does not."""
    with_lpips = evaluation.lpips is not None and evaluation.shift_truth
    compared = evaluation.shift_truth
    table = Table(title="views beside the drive", title_justify="left", box=SIMPLE_HEAD)
    names = ["ego", *(["n", "PSNR dB", "SSIM"] if compared else [])]
    names += [*(["LPIPS"] if with_lpips else []), *(["PSNR*", "SSIM*"] if compared else [])]
    for heading in (*names, "invented %", "empty %"):
        table.add_column(heading)
    scored = _cells(evaluation.whole, with_lpips) if compared else []
    number = [str(len(evaluation.frames))] if compared else []
    table.add_row("logged", *number, *scored, *(["", ""] if compared else []), *_gaps(evaluation))
    for scores in evaluation.shifts:
        cells = []
        if scores.whole is not None:
            moving = ["", ""] if scores.moving is None else _cells(scores.moving, False)
            cells = [str(len(scores.frames)), *_cells(scores.whole, with_lpips), *moving]
        table.add_row(scores.shift.name, *cells, *_gaps(scores))
    notes = ["* of moving objects: boxes, l and w x1.5"] if compared else []
    notes += ["invented: surfaces that no image shows; empty: neither surface nor seen sky"]
    table.caption, table.caption_justify = "\n".join(notes), "left"
    return table


def _gaps(of: SceneEvaluation | ShiftScores) -> list[str]:
    gaps = of.gaps
    return ["", ""] if gaps is None else [f"{100 * gaps.invented:.2f}", f"{100 * gaps.empty:.2f}"]


def _table(title: str, first: str, with_lpips: bool) -> Table:
    table = Table(title=title, title_justify="left", box=SIMPLE_HEAD)
    for heading in (first, "images", "PSNR dB", "SSIM", *(["LPIPS"] if with_lpips else [])):
        table.add_column(heading)
    return table


def _cells(score: RegionScore, with_lpips: bool) -> list[str]:
    cells = [f"{score.psnr:.2f}", f"{score.ssim:.3f}"]
    if with_lpips:
        cells.append("" if score.lpips is None else f"{score.lpips:.3f}")
    return cells


def shifted_truth(pool: OraclePool, views: Sequence[ShiftedView]) -> Iterator[Image]:
    """Ray-trace shifted views, each camera with the exposure it has in the log.

    Yields:
        (H, W, 3) uint8 of each view; moving vehicles are where they were.
    """
    return pool.map(_render, views)


def _render(oracle: Oracle, view: ShiftedView) -> Image:
    seed, camera = oracle.world.seed, view.camera_name
    frame = oracle.render(
        view.camera,
        view.world_from_camera,
        timestamp_us=view.timestamp_us,
        exposure=oracle.world.exposure(camera, view.timestamp_us),
        rng=np.random.default_rng([seed, _STREAM, sensor_number(camera), view.frame]),
    )
    return frame.rgb
