"""The first screen and the section on the truth, from the comparison with the oracle."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from recast.metrics import Agreement, AngleBin, OracleView, OracleViews, read_oracle_views
from recast.reporting import palette
from recast.reporting.actor_sheet import SIDES
from recast.reporting.inputs import NotMade, ShowcasePart, TruthPart
from recast.reporting.page import Media, PageAssets
from recast.reporting.plots import Figure, Plot
from recast.reporting.tables import TableCell, Tone

_LIMIT = 60.0  # degrees beyond which a view is one that the log never had
_BINS = ((0, 30), (30, 60), (60, 90), (90, 120), (120, 150), (150, 180.1))
_TITLES = {
    "mask_iou": ("Mask IoU with the truth", "mask IoU"),
    "psnr": ("PSNR inside the vehicle's box", "PSNR [dB]"),
}
_MEASURES: Mapping[str, tuple[str, int, str]] = {
    "psnr": ("PSNR", 1, "\u00a0dB"),
    "ssim": ("SSIM", 3, ""),
    "mask_iou": ("mask IoU", 2, ""),
}
"""Field of `Agreement` to label, digits and unit."""
_NAMES = {"baseline": "street's own actor", "candidate": "generated actor", "truth": "truth"}
"""Where the run did not drive with one of them."""


def truth_plots(part: TruthPart) -> tuple[Plot, ...]:
    """One plot for each measure: a dot for each view, a line through the means of 30 degrees."""
    return tuple(_plot(part, measure, *words) for measure, words in _TITLES.items())


def _plot(part: TruthPart, measure: str, title: str, label: str) -> Plot:
    angles = np.array([view.angle for view in part.views.views])
    values = {
        arm: np.array([getattr(getattr(v, arm), measure) for v in part.views.views])
        for arm in part.colours
    }
    every = np.concatenate(list(values.values()))
    low, high = (0.0, 1.02) if measure == "mask_iou" else (every.min() - 1.0, every.max() + 1.0)
    horizontal = "angle from the nearest logged view [degrees]; shaded: 60 and more"
    figure = Figure(180.0, float(low), float(high), label, horizontal, 30.0)
    figure.band(_LIMIT, 180.0)
    told = []
    for arm, index in part.colours.items():
        colour = palette.css(palette.arm_colour(index))
        figure.dots(angles, values[arm], colour, 3.5, 0.55)
        members = [(angles >= first) & (angles < last) for first, last in _BINS]
        means = [(angles[m].mean(), values[arm][m].mean()) for m in members if m.any()]
        figure.line([at for at, _ in means], [mean for _, mean in means], colour, 2.6)
        beyond = values[arm][angles >= _LIMIT]
        if len(beyond):
            told.append(f"{part.names[arm]}: mean {beyond.mean():.2f} beyond {_LIMIT:.0f} degrees")
    return figure.plot(title, "; ".join(told) or title)


@dataclass(frozen=True)
class TruthLine:
    """One range of angles: how many views, and for each measure a cell an arm.

    The note of a cell is the paired difference with its interval.
    """

    label: str
    views: int
    cells: tuple[TableCell, ...]
    total: bool


@dataclass(frozen=True)
class TruthView:
    """The section, ready for the page.

    Attributes:
        lines: lines of the table; the last two gather the ones above.
        pictures: caption and picture of each view, the furthest from the log first.
    """

    part: TruthPart
    lines: tuple[TruthLine, ...]
    plots: tuple[Plot, ...]
    pictures: tuple[tuple[str, Media | NotMade], ...]


def truth_parts(
    folder: str | Path, arms: Mapping[str, str], *, baseline: str | None, candidate: str, truth: str
) -> tuple[ShowcasePart, TruthPart]:
    """First screen and section from the folder that `evaluate_oracle_views` wrote.

    Args:
        arms: arms as in `ReportInputs`, for names and colours.
        baseline: the one of `arms` that shows the street's own actor; None where none does.

    Raises:
        InputError: the folder's record is missing or broken.
    """
    folder = Path(folder)
    views = read_oracle_views(folder)
    keys = {"baseline": baseline, "candidate": candidate, "truth": truth}
    names = {side: arms.get(key or "", _NAMES[side]) for side, key in keys.items()}
    order = [*arms]
    colours = {
        side: order.index(key) if (key := keys[side]) in order else len(order)
        for side in ("baseline", "candidate")
    }
    pictures = {view.index: folder / view.picture for view in views.views}
    return _showcase(folder, views, names), TruthPart(views, names, colours, pictures)


def truth_view(part: TruthPart, assets: PageAssets) -> TruthView:
    """Copy the pictures and gather what the page says."""
    furthest_first = sorted(part.views.views, key=lambda view: (-view.angle, view.index))
    return TruthView(
        part=part,
        lines=tuple(_line(b) for b in part.views.summary if b.views),
        plots=truth_plots(part),
        pictures=tuple(
            (_caption(view), assets.photo(f"truth-{view.index:03d}", part.pictures[view.index]))
            for view in furthest_first
            if view.index in part.pictures
        ),
    )


def angle_label(low: float, high: float) -> str:
    """A range of degrees in words."""
    if high == 180.0:
        return "all views" if low == 0.0 else f"{low:.0f}° and more"
    return f"{low:.0f}° to {high:.0f}°"


def _showcase(folder: Path, views: OracleViews, names: Mapping[str, str]) -> ShowcasePart:
    view = next(v for v in views.views if v.index == views.showcase)
    side = SIDES[round(view.azimuth / 45) % 8]
    beyond = views.beyond_60
    numbers = ""
    if beyond.baseline is not None and beyond.candidate is not None:
        change = beyond.difference["mask_iou"]
        before, after = beyond.baseline, beyond.candidate
        numbers = (
            f"Over all {beyond.views} views 60° or more from the log, {names['baseline']} → "
            f"{names['candidate']}: PSNR {before.psnr:.1f} → {after.psnr:.1f}\u00a0dB, "
            f"mask IoU {before.mask_iou:.2f} → {after.mask_iou:.2f} ({change.point:+.2f}, "
            f"{100 * change.level:.0f} % interval {change.low:+.2f} to {change.high:+.2f})."
        )
    return ShowcasePart(
        caption=f"The vehicle seen from its {side}, {view.distance:.0f} m ahead of the camera and "
        f"{view.angle:.0f}° away from the nearest of the {views.logged} recorded images that show "
        f"it. Camera and street are those of frame {view.frame} of the log.",
        pictures={name: folder / f"showcase_{key}.png" for key, name in names.items()},
        notes={
            names["baseline"]: _scores(view.baseline),
            names["candidate"]: _scores(view.candidate),
            names["truth"]: "rendered from the synthetic world of the log",
        },
        best=_better(view, names),
        numbers=numbers,
    )


def _better(view: OracleView, names: Mapping[str, str]) -> str | None:
    """The arm that is nearer to the truth in both PSNR and mask IoU."""
    baseline, candidate = view.baseline, view.candidate
    if candidate.psnr > baseline.psnr and candidate.mask_iou > baseline.mask_iou:
        return names["candidate"]
    if baseline.psnr > candidate.psnr and baseline.mask_iou > candidate.mask_iou:
        return names["baseline"]
    return None


def _line(angle_bin: AngleBin) -> TruthLine:
    cells: list[TableCell] = []
    assert angle_bin.baseline is not None and angle_bin.candidate is not None
    for measure, (_, digits, unit) in _MEASURES.items():
        baseline = getattr(angle_bin.baseline, measure)
        candidate = getattr(angle_bin.candidate, measure)
        change, better = angle_bin.difference[measure], angle_bin.candidate_better[measure]
        note = f"{change.point:+.{digits}f} ({change.low:+.{digits}f} to {change.high:+.{digits}f})"
        note += f", better in {better} of {angle_bin.views}"
        for value, other, remark in ((baseline, candidate, None), (candidate, baseline, note)):
            tone: Tone = "good" if value > other else "plain"
            cells.append(TableCell(f"{value:.{digits}f}{unit}", tone, remark))
    low, high = angle_bin.low, angle_bin.high
    total = (low, high) in ((60.0, 180.0), (0.0, 180.0))
    return TruthLine(angle_label(low, high), angle_bin.views, tuple(cells), total)


def _caption(view: OracleView) -> str:
    side = SIDES[round(view.azimuth / 45) % 8]
    known = "" if view.coverage is None else f", {view.coverage.invented:.0%} of it invented"
    return (
        f"{view.angle:.0f}° from the log, {side} at {view.distance:.0f} m{known}: "
        f"mask IoU {view.baseline.mask_iou:.2f} and {view.candidate.mask_iou:.2f}, "
        f"PSNR {view.baseline.psnr:.1f} and {view.candidate.psnr:.1f} dB"
    )


def _scores(score: Agreement) -> str:
    return ", ".join(
        f"{label} {getattr(score, measure):.{digits}f}{unit}"
        for measure, (label, digits, unit) in _MEASURES.items()
    )
