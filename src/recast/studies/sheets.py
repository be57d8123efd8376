"""Sheets for the eye: one vehicle's views with their differences, or the vehicles of a study."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass

import cv2
import numpy as np

from recast.arrays import Array, Image, Mask
from recast.core.images import draw_text
from recast.metrics.actor_scores import ScoredCutout, Window

_WIDTH, _HEIGHT = 320, 230  # pixels of a tile
_EDGE, _TWO_LINES = 4, 40
_GREY = 0.55  # behind the vehicles, so that black ones are seen too
TILE = (136, 92)
"""Width and height of a tile, pixels."""
_GAP, _HEADER, _CAPTION = 12, 26, 14
_MARGIN = 0.1


@dataclass(frozen=True)
class ComparedView:
    """A reserved view.

    Attributes:
        caption: text that says where the view is from, and the scores.
        truth, shown: photograph and render.
    """

    caption: str
    truth: ScoredCutout
    shown: ScoredCutout


def comparison_sheet(title: str, source: ScoredCutout, views: Sequence[ComparedView]) -> Image:
    """(H, W, 3) uint8; a row for every view, the input in front of the first.

    Tiles show what surrounds both vehicles, before grey; the difference is the absolute one of
    the images before black, as they are scored.
    """
    first = _fitted(source.before(_GREY)[_around(source.mask)], _GREY)
    rows = []
    for index, view in enumerate(views):
        window = _around(view.truth.mask | view.shown.mask)
        tiles = [
            first if index == 0 else np.full_like(first, 255),
            _fitted(view.truth.before(_GREY)[window], _GREY),
            _fitted(view.shown.before(_GREY)[window], _GREY),
            _fitted(np.abs(view.shown.rgb - view.truth.rgb)[window], 0.0),
        ]
        captions = [
            f"input: {title}" if index == 0 else "",
            "photograph",
            f"render  {view.caption}",
            "difference",
        ]
        rows.append(np.hstack([_captioned(t, c) for t, c in zip(tiles, captions, strict=True)]))
    return np.vstack(rows)


def _around(mask: Mask) -> tuple[slice, slice]:
    """Rows and columns of the rectangle around a mask (H, W) and a margin of 4 % of its width."""
    rows, columns = np.flatnonzero(mask.any(axis=1)), np.flatnonzero(mask.any(axis=0))
    margin = 1 + int(0.04 * (columns[-1] - columns[0]))
    return (
        slice(max(int(rows[0]) - margin, 0), int(rows[-1]) + 1 + margin),
        slice(max(int(columns[0]) - margin, 0), int(columns[-1]) + 1 + margin),
    )


def _fitted(image: Array, grey: float) -> Image:
    """An image (H, W, 3) in [0, 1] fitted into the middle of a tile of that grey."""
    height, width = image.shape[:2]
    scale = min(_WIDTH / width, _HEIGHT / height)
    size = (max(1, round(width * scale)), max(1, round(height * scale)))
    way = cv2.INTER_AREA if scale < 1 else cv2.INTER_LINEAR
    fitted = cv2.resize((image * 255).round().astype(np.uint8), size, interpolation=way)
    middle = np.full((_HEIGHT, _WIDTH, 3), round(grey * 255), np.uint8)
    left, top = (_WIDTH - size[0]) // 2, (_HEIGHT - size[1]) // 2
    middle[top : top + size[1], left : left + size[0]] = fitted
    return middle


def _captioned(picture: Image, caption: str) -> Image:
    """The picture under its caption of up to two lines, with a white edge."""
    page = np.full((_HEIGHT + _TWO_LINES + _EDGE, _WIDTH + _EDGE, 3), 255, np.uint8)
    page[_TWO_LINES : _TWO_LINES + _HEIGHT, :_WIDTH] = picture
    for line, text in enumerate(caption.split("\n")):
        draw_text(page, (4, 15 + 18 * line), text, _INK, 14, "ls")
    return page


@dataclass(frozen=True)
class SheetRow:
    """One vehicle.

    Attributes:
        caption: text under the input.
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


def tile(cutout: ScoredCutout, window: Window) -> Image:
    """A vehicle before grey, a window of it brought to the size of a tile."""
    pixels = (cutout.within(window).before(_GREY) * 255).round().astype(np.uint8)
    way = cv2.INTER_AREA if window.width > TILE[0] else cv2.INTER_LINEAR
    return np.asarray(cv2.resize(pixels, TILE, interpolation=way), np.uint8)


def strip(cutouts: Sequence[ScoredCutout], windows: Sequence[Window]) -> Image:
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
        models: names of the columns between input and truth.
    """
    views = max(row.truth.shape[1] for row in rows)
    width = TILE[0] + (len(models) + 1) * (views + _GAP)
    lines = [_header([title, *models, "truth"], views, width)]
    for row in rows:
        line = np.full((TILE[1] + _CAPTION, width, 3), 255, np.uint8)
        line[: TILE[1], : TILE[0]] = row.source
        draw_text(line, (2, TILE[1] + 11), row.caption, _INK, 10, "ls")
        left = TILE[0] + _GAP
        for shown in [*row.strips, row.truth]:
            if shown is None:
                draw_text(line, (left + 8, TILE[1] // 2), "not made", _INK, 14, "ls")
            else:
                line[: TILE[1], left : left + shown.shape[1]] = shown
            left += views + _GAP
        lines.append(line)
    return np.vstack(lines)


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
        draw_text(line, (left + 2, 17), name, _INK, 14, "ls")
        left += TILE[0] + _GAP if index == 0 else views + _GAP
    return line


_INK = (40, 40, 40)
