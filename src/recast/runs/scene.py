"""Training and judging a scene on a terminal; the truth of synthetic drives."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from contextlib import ExitStack
from functools import partial
from pathlib import Path

import numpy as np
from rich.box import SIMPLE_HEAD
from rich.console import Console, RenderableType
from rich.markup import escape
from rich.progress import BarColumn, MofNCompleteColumn, Progress, TimeRemainingColumn
from rich.table import Table
from rich.text import Text

from recast.arrays import Image
from recast.core.diagnostics import ProgressBar
from recast.core.errors import printable
from recast.logs import DrivingLog
from recast.metrics.perceptual import load_distances
from recast.reconstruction import (
    SHIFTS,
    RegionScore,
    SceneConfig,
    SceneEvaluation,
    ShiftedView,
    TrainingStatus,
    evaluate_scene,
    read_training_config,
)
from recast.scene import load_scene
from recast.scene.exchange import IMPORT_FILE
from recast.synthetic import Oracle, is_synthetic, world_of
from recast.synthetic.world import exposure, sensor_number
from recast.synthetic.write import OraclePool

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
        super().__init__("{task.description}", *columns, console=console, refresh_per_second=4)
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
    if evaluation.shift_truth:
        console.print(shift_table(evaluation))
    elif evaluation.shifts:
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
    """Views beside the drive against the truth, a line for each shift of the ego."""
    with_lpips = evaluation.lpips is not None
    table = _table("views beside the drive, against the truth", "ego", with_lpips)
    table.add_column("PSNR* dB")
    table.add_column("SSIM*")
    for scores in evaluation.shifts:
        if scores.whole is None:
            continue
        moving = ("", "") if scores.moving is None else _cells(scores.moving, False)
        cells = _cells(scores.whole, with_lpips)
        table.add_row(scores.shift.name, str(len(scores.frames)), *cells, *moving)
    table.caption, table.caption_justify = "* of moving objects: boxes, l and w x1.5", "left"
    return table


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
        exposure=exposure(seed, camera),
        rng=np.random.default_rng([seed, _STREAM, sensor_number(camera), view.frame]),
    )
    return frame.rgb
