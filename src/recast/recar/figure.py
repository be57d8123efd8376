"""The dataset figure of the paper (section 2): view sheet, colours as bars, types as a pie."""

from __future__ import annotations

from pathlib import Path

import cv2
import numpy as np
from matplotlib.axes import Axes
from matplotlib.backends.backend_agg import FigureCanvasAgg
from matplotlib.colors import is_color_like, to_rgb
from matplotlib.figure import Figure
from numpy.typing import NDArray

from recast.core.errors import printable
from recast.core.files import atomic_file, disk_errors
from recast.geometry.colour import linear_to_srgb
from recast.recar.statistics import SetStatistics
from recast.recar.views import IdentitySource, Image, VehicleSource
from recast.synthetic.vehicles import COLOURS

FIGURE_FILES = ("dataset.png", "views.png", "colours.png", "types.png")

_INK, _MUTED, _EDGE = "#1f2430", "#6b7280", "#9aa1ad"
_CELL = (360, 240)  # pixels at most of a view in the sheet, before it is cut
_PANEL = (245, 246, 248)  # behind the cars
_PIE = (
    "#3b6ea8",
    "#e08a3c",
    "#5b9e6f",
    "#c2555a",
    "#8b78b5",
    "#8f7360",
    "#cf84b0",
    "#7d858f",
    "#b3ab4b",
    "#58a9b4",
)
_SMALLEST_SLICE = 0.025  # narrower ones have no room for a label of their own


def write_figure(vehicle_set: VehicleSource, statistics: SetStatistics, folder: Path) -> None:
    """Write dataset.png, and its panels as views.png, colours.png and types.png.

    Args:
        vehicle_set: set whose pictures are shown.
        statistics: statistics of that set.
        folder: folder to write to; made where it is missing.

    Raises:
        InputError: a picture is broken.
    """
    with disk_errors(folder):
        folder.mkdir(parents=True, exist_ok=True)
    chosen = representatives(vehicle_set, 6)
    columns = _columns(vehicle_set.record.views, 6)
    sheet = view_sheet(chosen, columns)
    height = max(0.96 * 11.2 * sheet.shape[0] / sheet.shape[1] + 1.0, 6.4)

    figure = Figure(figsize=(17.0, height), facecolor="white")
    grid = figure.add_gridspec(
        2,
        2,
        width_ratios=(11.2, 5.0),
        left=0.062,
        right=0.985,
        top=1 - 0.8 / height,
        bottom=0.05,
        wspace=0.13,
        hspace=0.34,
    )
    _draw_views(figure.add_subplot(grid[:, 0]), sheet, chosen, columns)
    _draw_colours(figure.add_subplot(grid[0, 1]), statistics.colours)
    _draw_types(figure.add_subplot(grid[1, 1]), statistics.kinds)
    record = vehicle_set.record
    figure.suptitle(
        f"{_words(record.name)}: {statistics.identities:,} identities, {record.views} views each, "
        f"{statistics.pictures:,} RGBA images of {record.width}x{record.height}",
        x=0.062,
        y=1 - 0.12 / height,
        ha="left",
        fontsize=15,
        color=_INK,
        weight="bold",
    )
    _save(figure, folder / "dataset.png")

    many = representatives(vehicle_set, 12)
    columns = _columns(vehicle_set.record.views, 10)
    sheet = view_sheet(many, columns)
    figure = Figure(figsize=(16, 15.0 * sheet.shape[0] / sheet.shape[1] + 0.5), facecolor="white")
    _draw_views(figure.add_axes((0.07, 0.005, 0.925, 0.965)), sheet, many, columns)
    _save(figure, folder / "views.png")
    for name, draw, counts in (
        ("colours.png", _draw_colours, statistics.colours),
        ("types.png", _draw_types, statistics.kinds),
    ):
        figure = Figure(figsize=(7, 5), facecolor="white")
        draw(figure.add_axes((0.04, 0.16, 0.92, 0.76)), counts)
        _save(figure, folder / name)


def representatives(vehicle_set: VehicleSource, count: int) -> list[IdentitySource]:
    """Up to `count` identities: all kinds in turn, the most frequent first, colours varied."""
    labels = [(one.id, one.kind, one.colour) for one, _ in vehicle_set.records()]
    by_kind: dict[str, list[tuple[str, str | None]]] = {}
    for id, kind, colour in sorted(labels, key=lambda label: label[0]):
        by_kind.setdefault(kind, []).append((id, colour))
    queues = sorted(by_kind.values(), key=len, reverse=True)
    chosen: list[IdentitySource] = []
    shown: dict[str | None, int] = {}
    while len(chosen) < min(count, len(labels)):
        for queue in queues:
            if queue and len(chosen) < count:
                rarest = min(queue, key=lambda one: shown.get(one[1], 0))
                queue.remove(rarest)
                shown[rarest[1]] = shown.get(rarest[1], 0) + 1
                chosen.append(vehicle_set.identities[rarest[0]])
    return chosen


def view_sheet(identities: list[IdentitySource], views: list[int]) -> Image:
    """A sheet (rows, columns, 3) uint8: a row for each identity, a column for each view.

    All cells are cut alike, to what is not empty in every one of them.
    """
    cells = [[_cell(one.view(view)) for view in views] for one in identities]
    rows, columns = np.nonzero(np.max([cell[..., 3] for row in cells for cell in row], axis=0))
    height, width = cells[0][0].shape[:2]
    edge = round(0.03 * width)
    top, bottom = max(rows.min() - edge, 0), min(rows.max() + 1 + edge, height)
    left, right = max(columns.min() - edge, 0), min(columns.max() + 1 + edge, width)
    cut = [[_over_panel(cell[top:bottom, left:right]) for cell in row] for row in cells]
    return np.vstack([np.hstack(row) for row in cut])


def _columns(views: int, count: int) -> list[int]:
    """About `count` views, evenly apart where the number of views has a fitting divisor."""
    even = [n for n in range(count - 2, count + 3) if n > 0 and views % n == 0]
    columns = min(even, key=lambda n: (abs(n - count), -n)) if even else min(count, views)
    return [i * views // columns for i in range(columns)]


def _cell(rgba: Image) -> NDArray[np.float32]:
    """Shrunk to fit `_CELL`: colour multiplied by alpha, and alpha, in [0, 1]."""
    alpha = rgba[..., 3:].astype(np.float32) / 255
    light = np.concatenate([rgba[..., :3] * (alpha / 255), alpha], axis=-1)
    shrink = min(_CELL[0] / rgba.shape[1], _CELL[1] / rgba.shape[0])
    size = (max(round(rgba.shape[1] * shrink), 1), max(round(rgba.shape[0] * shrink), 1))
    return np.asarray(cv2.resize(light, size, interpolation=cv2.INTER_AREA), np.float32)


def _over_panel(cell: NDArray[np.float32]) -> Image:
    over = 255 * cell[..., :3] + np.array(_PANEL, np.float32) * (1 - cell[..., 3:])
    over[:1], over[:, :1] = 255, 255  # a thin white line between cells
    return np.clip(np.round(over), 0, 255).astype(np.uint8)


def _draw_views(
    axes: Axes, sheet: Image, identities: list[IdentitySource], columns: list[int]
) -> None:
    record = identities[0].set_record
    rows = len(identities)
    axes.imshow(sheet, interpolation="antialiased", aspect="equal", extent=(0, 1, 0, 1))
    axes.set_aspect(sheet.shape[0] / sheet.shape[1])
    axes.set_anchor("N")
    axes.axis("off")
    for place, view in enumerate(columns):
        axes.text(
            (place + 0.5) / len(columns),
            1.004,
            f"{record.azimuths_deg[view]:g}°",
            ha="center",
            va="bottom",
            color=_MUTED,
            fontsize=10,
        )
    for row, identity in enumerate(identities):
        one = identity.record
        axes.text(
            -0.008,
            1 - (row + 0.5) / rows,
            f"{_words(one.kind)}\n{_words(one.colour or '')}",
            ha="right",
            va="center",
            color=_INK,
            fontsize=10,
            linespacing=1.4,
        )


def _draw_colours(axes: Axes, counts: dict[str, int]) -> None:
    total = sum(counts.values())
    shares = [100 * count / total for count in counts.values()]
    places = list(range(len(counts)))
    faces = [swatch(name) for name in counts]
    bars = axes.bar(places, shares, width=0.72, linewidth=0.8, edgecolor=_EDGE)
    for bar, face in zip(bars, faces, strict=True):
        bar.set_facecolor(face if face is not None else "white")
        bar.set_hatch(None if face is not None else "////")
    for place, share in zip(places, shares, strict=True):
        axes.text(
            place,
            share + 0.015 * max(shares),
            f"{share:.0f}" if share >= 1 else f"{share:.1f}",
            ha="center",
            va="bottom",
            color=_INK,
            fontsize=9,
        )
    axes.set_xticks(
        places, [_words(name) for name in counts], rotation=38, ha="right", rotation_mode="anchor"
    )
    axes.set_xlim(-0.6, max(len(counts), 4) - 0.4)
    axes.set_ylim(0, 1.12 * max(shares))
    axes.set_yticks([])
    axes.tick_params(axis="x", length=0, colors=_INK, labelsize=10)
    for side in ("left", "top", "right"):
        axes.spines[side].set_visible(False)
    axes.spines["bottom"].set_color(_EDGE)
    axes.set_title("Colours, % of identities", loc="left", fontsize=12, color=_INK, weight="bold")


def _draw_types(axes: Axes, counts: dict[str, int]) -> None:
    total = sum(counts.values())
    shown = {name: count for name, count in counts.items() if count >= _SMALLEST_SLICE * total}
    if rest := total - sum(shown.values()):
        shown["others"] = shown.get("others", 0) + rest
    colours = [_PIE[i % len(_PIE)] for i in range(len(shown))]
    wedges = axes.pie(
        list(shown.values()),
        colors=colours,
        startangle=90,
        counterclock=False,
        radius=1.0,
        wedgeprops={"width": 0.46, "edgecolor": "white", "linewidth": 1.5},
    )[0]
    # Names in a list of their own: beside narrow slices they would lie on one another.
    axes.legend(
        wedges,
        [f"{_words(name)}  {100 * count / total:.0f} %" for name, count in shown.items()],
        loc="center left",
        bbox_to_anchor=(0.56, 0.5),
        frameon=False,
        fontsize=10,
        labelcolor=_INK,
        handlelength=1.0,
        handleheight=1.0,
        labelspacing=0.6,
    )
    # Limits in the shape of the axes, which `equal` would narrow otherwise, title and all.
    box = axes.get_window_extent()
    axes.set_xlim(-1.1, 2.2 * box.width / box.height - 1.1)
    axes.set_ylim(-1.1, 1.1)
    axes.set_title("Types", loc="left", fontsize=12, color=_INK, weight="bold")


def _words(text: str) -> str:
    """A text of a set as a label: one short line, in which matplotlib finds no formula."""
    line = printable(text)
    return (line if len(line) <= 40 else line[:39] + "…").replace("$", r"\$")


def swatch(name: str) -> tuple[float, float, float] | None:
    """sRGB in [0, 1] of a colour's name, or None for a name that nobody knows."""
    if name in COLOURS:
        red, green, blue = linear_to_srgb(np.asarray(COLOURS[name].rgb, np.float64)).tolist()
        return red, green, blue
    if not is_color_like(name):
        return None
    red, green, blue = to_rgb(name)
    return red, green, blue


def _save(figure: Figure, path: Path) -> None:
    FigureCanvasAgg(figure)
    with atomic_file(path) as partial:
        figure.savefig(partial, format="png", dpi=110, metadata={"Software": None})
