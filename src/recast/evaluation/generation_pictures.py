"""Sheets of a generation study: rows are vehicles; input, every model's views, and the truth."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass

import cv2
import numpy as np
from numpy.typing import NDArray

from recast.evaluation.actor_scores import Cutout, Mask, Window

Image = NDArray[np.uint8]

TILE = (136, 92)
"""Width and height of a tile, pixels."""
_GREY = 0.55  # behind the vehicles, so that black ones are seen too
_GAP, _HEADER, _CAPTION = 12, 26, 14
_MARGIN = 0.1


@dataclass(frozen=True)
class SheetRow:
    """One vehicle.

    Attributes:
        caption: under the input.
        source: the input's tile.
        strips: the views of each model, in their order; None where it could not be made.
        truth: the photographs of the views.
    """

    caption: str
    source: Image
    strips: Sequence[Image | None]
    truth: Image


def tile_window(mask: Mask) -> Window:
    """The rectangle of a tile's shape around a mask (H, W) and a margin."""
    rows, columns = np.flatnonzero(mask.any(axis=1)), np.flatnonzero(mask.any(axis=0))
    if len(rows) == 0:
        return Window(0, 0, *mask.shape)
    width = (1 + 2 * _MARGIN) * (columns[-1] + 1 - columns[0])
    height = (1 + 2 * _MARGIN) * (rows[-1] + 1 - rows[0])
    width, height = max(width, height * TILE[0] / TILE[1]), max(height, width * TILE[1] / TILE[0])
    left = (columns[0] + columns[-1] + 1 - width) / 2
    top = (rows[0] + rows[-1] + 1 - height) / 2
    return Window(round(top), round(left), max(1, round(height)), max(1, round(width)))


def tile(cutout: Cutout, window: Window) -> Image:
    """A vehicle before grey, a window of it brought to the size of a tile."""
    pixels = (cutout.within(window).before(_GREY) * 255).round().astype(np.uint8)
    way = cv2.INTER_AREA if window.width > TILE[0] else cv2.INTER_LINEAR
    return np.asarray(cv2.resize(pixels, TILE, interpolation=way), np.uint8)


def strip(cutouts: Sequence[Cutout], windows: Sequence[Window]) -> Image:
    """Tiles of several views side by side, a thin white line after each."""
    tiles = []
    for cutout, window in zip(cutouts, windows, strict=True):
        one = tile(cutout, window)
        one[:, -1:] = 255
        tiles.append(one)
    return np.hstack(tiles)


def sheet(title: str, models: Sequence[str], rows: Sequence[SheetRow]) -> Image:
    """(H, W, 3) uint8.

    Args:
        title: of the inputs' column.
        models: names of the columns between input and truth.
        rows: at least one.
    """
    views = max(row.truth.shape[1] for row in rows)
    width = TILE[0] + (len(models) + 1) * (views + _GAP)
    lines = [_header([title, *models, "truth"], views, width)]
    for row in rows:
        line = np.full((TILE[1] + _CAPTION, width, 3), 255, np.uint8)
        line[: TILE[1], : TILE[0]] = row.source
        _write(line, row.caption, (2, TILE[1] + 11), 0.34)
        left = TILE[0] + _GAP
        for shown in [*row.strips, row.truth]:
            if shown is None:
                _write(line, "not made", (left + 8, TILE[1] // 2), 0.45)
            else:
                line[: TILE[1], left : left + shown.shape[1]] = shown
            left += views + _GAP
        lines.append(line)
    page: Image = np.vstack(lines)
    return page


def pages(rows: Sequence[SheetRow], most: int = 10) -> list[Sequence[SheetRow]]:
    """Rows by sheet, evenly."""
    count = -(-len(rows) // most)
    each = -(-len(rows) // count) if count else 1
    return [rows[first : first + each] for first in range(0, len(rows), each)]


def applied_caption(id: str, applied: Sequence[Mapping[str, float | str]]) -> str:
    """What stands under an input: the vehicle, and what its picture went through."""
    kinds = ", ".join(f"{one['name']} {float(one['severity']):.1f}" for one in applied)
    return f"{id}: {kinds}" if kinds else id


def _header(names: Sequence[str], views: int, width: int) -> Image:
    line = np.full((_HEADER, width, 3), 255, np.uint8)
    left = 0
    for index, name in enumerate(names):
        _write(line, name, (left + 2, 17), 0.48)
        left += TILE[0] + _GAP if index == 0 else views + _GAP
    return line


def _write(image: Image, text: str, where: tuple[int, int], size: float) -> None:
    cv2.putText(
        image, text, where, cv2.FONT_HERSHEY_SIMPLEX, size, (40, 40, 40), 1, cv2.LINE_AA
    )  # fmt: skip
