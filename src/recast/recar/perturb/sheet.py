"""The sheet of all perturbations: each kind from weak to strong, and draws as a model sees them."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import cv2
import numpy as np
from matplotlib.backends.backend_agg import FigureCanvasAgg
from matplotlib.figure import Figure

from recast.arrays import Image
from recast.core.files import atomic_file
from recast.recar.perturb.compose import PerturbationConfig, Perturbed, perturb, surroundings
from recast.recar.perturb.kind import Kind, find_object, premultiplied
from recast.trellis import crop_to_object

SEVERITIES = (0.0, 0.25, 0.5, 0.75, 1.0)
_DRAWS = 10
_MARGIN = 0.12  # around the object, over its extent
_CELL = 200  # pixels of a cell's longer side
_PANEL = np.array((0.87, 0.88, 0.90), np.float32)  # what is transparent shows this
_INK, _MUTED = "#1f2430", "#6b7280"
_DPI = 100


def write_sheet(rgba: Image, config: PerturbationConfig, seed: int, path: Path) -> None:
    """Draw the sheet of one picture as PNG.

    Each kind is a row of five severities over light grey, with equal random draws, so that one
    fault grows from left to right. Below are ten results of the whole configuration as the model
    gets them: square and on black.

    Args:
        rgba: (H, W, 4) uint8, straight alpha.
        config: figures of all kinds; those of weight 0 are shown too.
        seed: of everything random.
        path: PNG to write.

    Raises:
        InputError: `rgba` is refused by `recast.trellis.check_crop`.
    """
    around = _with_margin(surroundings(rgba, config.finest))
    kinds = config.kinds()
    rows = -(-len(kinds) // 2)
    cell_height, cell_width = _cell(around).shape[:2]
    gap, label, head, foot = 26, 110, 66, _CELL + 92
    width = 2 * (label + len(SEVERITIES) * (cell_width + 4)) + gap
    height = head + rows * (cell_height + 6) + foot
    figure = Figure(figsize=(width / _DPI, height / _DPI), dpi=_DPI, facecolor="white")

    canvas = np.full((height, width, 3), 255, np.uint8)

    def put(picture: Image, left: float, top: float) -> None:
        row, column = round(top), round(left)
        canvas[row : row + picture.shape[0], column : column + picture.shape[1]] = picture

    def write(text: str, x: float, y: float, **style: Any) -> None:
        figure.text(x / width, 1 - y / height, text, **style)

    write(
        "Perturbations from severity 0 to 1",
        12,
        24,
        fontsize=14,
        color=_INK,
        weight="bold",
        va="center",
    )
    for index, kind in enumerate(kinds):
        column, row = divmod(index, rows)
        left = column * (width + gap) / 2
        top = head + row * (cell_height + 6)
        write(
            kind.name + ("\n(off)" if kind.weight == 0 else ""),
            left + label - 8,
            top + cell_height / 2,
            fontsize=10,
            color=_INK,
            ha="right",
            va="center",
        )
        for place, severity in enumerate(SEVERITIES):
            x = left + label + place * (cell_width + 4)
            if row == 0:
                write(
                    f"{severity:g}",
                    x + cell_width / 2,
                    head - 10,
                    fontsize=9,
                    color=_MUTED,
                    ha="center",
                    va="center",
                )
            put(_cell(_spoil(around, kind, severity, seed, index)), x, top)
    top = head + rows * (cell_height + 6) + 14
    write(
        f"Drawn by this configuration, as the model gets them (clean with probability "
        f"{config.rho_clean:g})",
        12,
        top + 10,
        fontsize=12,
        color=_INK,
        weight="bold",
        va="center",
    )
    side = min((width - 24) // _DRAWS - 4, _CELL)
    for place in range(_DRAWS):
        drawn = perturb(rgba, config, np.random.default_rng([seed, len(kinds), place]))
        x = 12 + place * (side + 4)
        put(crop_to_object(drawn.rgba, side), x, top + 26)
        write(_caption(drawn), x, top + 30 + side, fontsize=7, color=_MUTED, va="top")
    axes = figure.add_axes((0, 0, 1, 1))
    axes.imshow(canvas, interpolation="none", aspect="auto")
    axes.set_axis_off()
    FigureCanvasAgg(figure)
    with atomic_file(path) as partial:
        figure.savefig(partial, format="png", metadata={"Software": None})


def _spoil(rgba: Image, kind: Kind, severity: float, seed: int, index: int) -> Image:
    return kind(rgba, severity, np.random.default_rng([seed, index]))


def _caption(drawn: Perturbed) -> str:
    return "\n".join(f"{name} {severity:.2f}" for name, severity in drawn.applied) or "clean"


def _with_margin(rgba: Image) -> Image:
    """Cut to the object and some room around it, transparent where the picture ends."""
    box = find_object(rgba)
    edge = round(_MARGIN * box.extent)
    padded = np.pad(rgba, ((edge, edge), (edge, edge), (0, 0)))
    return padded[box.top : box.bottom + 2 * edge, box.left : box.right + 2 * edge]


def _cell(rgba: Image) -> Image:
    """Over the panel, scaled to the size of a cell."""
    scale = _CELL / max(rgba.shape[:2])
    size = (max(round(rgba.shape[1] * scale), 1), max(round(rgba.shape[0] * scale), 1))
    shrink = cv2.INTER_AREA if scale < 1 else cv2.INTER_LINEAR
    mixed = cv2.resize(premultiplied(rgba), size, interpolation=shrink)
    over = mixed[..., :3] + _PANEL * (1 - mixed[..., 3:])
    return np.round(255 * np.clip(over, 0, 1)).astype(np.uint8)
