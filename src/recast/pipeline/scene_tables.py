"""An evaluation of a scene as tables for the terminal."""

from __future__ import annotations

from rich.box import SIMPLE_HEAD
from rich.markup import escape
from rich.table import Table

from recast.errors import printable
from recast.scene import RegionScore, SceneEvaluation


def evaluation_table(evaluation: SceneEvaluation) -> Table:
    """Held-out scores, and a last line for the depth."""
    with_lpips = evaluation.lpips is not None
    table = _table("held-out images", "region", with_lpips)
    frames = len(evaluation.frames)
    table.add_row("whole image", str(frames), *_cells(evaluation.whole, with_lpips))
    if evaluation.moving is not None:
        seen = sum(frame.moving is not None for frame in evaluation.frames)
        cells = _cells(evaluation.moving, with_lpips)
        table.add_row("what moves: boxes, l and w x1.5", str(seen), *cells)
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
    table = _table("beside the drive, against the truth", "ego", with_lpips)
    table.add_column("PSNR* dB")
    table.add_column("SSIM*")
    for scores in evaluation.shifts:
        if scores.whole is None:
            continue
        moving = ("", "") if scores.moving is None else _cells(scores.moving, False)
        cells = _cells(scores.whole, with_lpips)
        table.add_row(scores.shift.name, str(len(scores.frames)), *cells, *moving)
    table.caption, table.caption_justify = "* of what moves: boxes, l and w x1.5", "left"
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
