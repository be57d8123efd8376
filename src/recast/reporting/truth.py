"""The first screen and the section on the truth, from the comparison with the oracle."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path

from recast.evaluation import Agreement, AngleBin, OracleView, OracleViews, read_oracle_views
from recast.reporting.assets import Assets, Media
from recast.reporting.basics import SIDES, NotMade
from recast.reporting.figure import Plot
from recast.reporting.tables import Tone
from recast.reporting.truth_inputs import ShowcasePart, TruthPart
from recast.reporting.truth_plots import truth_plots

_MEASURES: Mapping[str, tuple[str, int, str]] = {
    "psnr": ("PSNR", 1, "\u00a0dB"),
    "ssim": ("SSIM", 3, ""),
    "mask_iou": ("mask IoU", 2, ""),
}
"""Field of `Agreement` to label, digits and unit."""


_NAMES = {"native": "native actor", "replaced": "replaced actor", "truth": "truth"}
"""Where the run did not drive with one of them."""


@dataclass(frozen=True)
class TruthCell:
    """One number of the table; `note` is the paired difference with its interval."""

    text: str
    tone: Tone = "plain"
    note: str | None = None


@dataclass(frozen=True)
class TruthLine:
    """One range of angles: how many views, and for each measure a cell a method."""

    label: str
    views: int
    cells: tuple[TruthCell, ...]
    total: bool


@dataclass(frozen=True)
class TruthView:
    """The section, ready for the page.

    Attributes:
        part: what it is made from.
        lines: of the table; the last two gather the ones above.
        plots: each measure over the angle.
        pictures: caption and picture of each view, the furthest from the log first.
    """

    part: TruthPart
    lines: tuple[TruthLine, ...]
    plots: tuple[Plot, ...]
    pictures: tuple[tuple[str, Media | NotMade], ...]


def truth_parts(
    folder: str | Path, methods: Mapping[str, str], truth: str = "oracle"
) -> tuple[ShowcasePart, TruthPart]:
    """First screen and section from the folder that `evaluate_oracle_views` wrote.

    Args:
        methods: as in `ReportInputs`; "native", "replaced" and the one named `truth` give names
            and colours where they are among them.

    Raises:
        InputError: the folder's record is missing or broken.
    """
    folder = Path(folder)
    views = read_oracle_views(folder)
    keys = {"native": "native", "replaced": "replaced", "truth": truth}
    names = {side: methods.get(key, _NAMES[side]) for side, key in keys.items()}
    order = list(dict.fromkeys([*methods, "native", "replaced"]))
    colours = {method: order.index(method) for method in ("native", "replaced")}
    pictures = {view.index: folder / view.picture for view in views.views}
    return _showcase(folder, views, names), TruthPart(views, names, colours, pictures)


def truth_view(part: TruthPart, assets: Assets) -> TruthView:
    """Copy the pictures and gather what the page says."""
    furthest_first = sorted(part.views.views, key=lambda view: (-view.angle, view.index))
    return TruthView(
        part=part,
        lines=tuple(_line(b) for b in part.views.summary if b.views),
        plots=truth_plots(part),
        pictures=tuple(
            (_caption(view), assets.picture(f"truth-{view.index:03d}", part.pictures[view.index]))
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
    if beyond.native is not None and beyond.replaced is not None:
        change = beyond.difference["mask_iou"]
        before, after = beyond.native, beyond.replaced
        numbers = (
            f"Over all {beyond.views} views 60° or more from the log, {names['native']} → "
            f"{names['replaced']}: PSNR {before.psnr:.1f} → {after.psnr:.1f}\u00a0dB, "
            f"mask IoU {before.mask_iou:.2f} → {after.mask_iou:.2f} ({change.point:+.2f}, "
            f"{100 * change.level:.0f} % interval {change.low:+.2f} to {change.high:+.2f})."
        )
    return ShowcasePart(
        caption=f"The vehicle from its {side}, {view.distance:.0f} m before the camera and "
        f"{view.angle:.0f}° away from the nearest of the {views.logged} recorded images that show "
        f"it. Camera and street are those of frame {view.frame} of the log.",
        pictures={name: folder / f"showcase_{key}.png" for key, name in names.items()},
        notes={
            names["native"]: _scores(view.native),
            names["replaced"]: _scores(view.replaced),
            names["truth"]: "rendered from the world that the log was made in",
        },
        best=_better(view, names),
        numbers=numbers,
    )


def _better(view: OracleView, names: Mapping[str, str]) -> str | None:
    """The method that is nearer to the truth in both PSNR and mask IoU."""
    native, replaced = view.native, view.replaced
    if replaced.psnr > native.psnr and replaced.mask_iou > native.mask_iou:
        return names["replaced"]
    if native.psnr > replaced.psnr and native.mask_iou > replaced.mask_iou:
        return names["native"]
    return None


def _line(angle_bin: AngleBin) -> TruthLine:
    cells: list[TruthCell] = []
    assert angle_bin.native is not None and angle_bin.replaced is not None
    for measure, (_, digits, unit) in _MEASURES.items():
        native, replaced = getattr(angle_bin.native, measure), getattr(angle_bin.replaced, measure)
        change, better = angle_bin.difference[measure], angle_bin.replaced_better[measure]
        note = f"{change.point:+.{digits}f} ({change.low:+.{digits}f} to {change.high:+.{digits}f})"
        note += f", better in {better} of {angle_bin.views}"
        cells.append(
            TruthCell(f"{native:.{digits}f}{unit}", "good" if native > replaced else "plain")
        )
        cells.append(
            TruthCell(
                f"{replaced:.{digits}f}{unit}", "good" if replaced > native else "plain", note
            )
        )
    low, high = angle_bin.low, angle_bin.high
    total = (low, high) in ((60.0, 180.0), (0.0, 180.0))
    return TruthLine(angle_label(low, high), angle_bin.views, tuple(cells), total)


def _caption(view: OracleView) -> str:
    side = SIDES[round(view.azimuth / 45) % 8]
    known = "" if view.coverage is None else f", {view.coverage.invented:.0%} of it invented"
    return (
        f"{view.angle:.0f}° from the log, {side} at {view.distance:.0f} m{known}: "
        f"mask IoU {view.native.mask_iou:.2f} and {view.replaced.mask_iou:.2f}, "
        f"PSNR {view.native.psnr:.1f} and {view.replaced.psnr:.1f} dB"
    )


def _scores(score: Agreement) -> str:
    return ", ".join(
        f"{label} {getattr(score, measure):.{digits}f}{unit}"
        for measure, (label, digits, unit) in _MEASURES.items()
    )
