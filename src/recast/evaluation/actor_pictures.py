"""One picture a vehicle: the input, and for every reserved view photograph, render, difference."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import cv2
import numpy as np
from numpy.typing import NDArray

from recast.evaluation.actor_scores import Cutout, Mask

Array = NDArray[np.float64]
Image = NDArray[np.uint8]

_WIDTH, _HEIGHT = 320, 230  # pixels of a tile
_GAP = 4
_CAPTION = 40
_GREY = 0.55  # behind the vehicles, so that black ones are seen too


@dataclass(frozen=True)
class ComparedView:
    """A reserved view.

    Attributes:
        caption: where from, and the scores.
        truth, shown: photograph and render.
    """

    caption: str
    truth: Cutout
    shown: Cutout


def comparison_sheet(title: str, source: Cutout, views: Sequence[ComparedView]) -> Image:
    """(H, W, 3) uint8; a row for every view, the input in front of the first.

    Tiles show what surrounds both vehicles, before grey; the difference is the absolute one of
    the images before black, as they are scored.

    Args:
        title: of the input.
        source: the input.
        views: what it is compared on, at least one.
    """
    first = _tile(source.before(_GREY)[_around(source.mask)], _GREY)
    rows = []
    for index, view in enumerate(views):
        window = _around(view.truth.mask | view.shown.mask)
        tiles = [
            first if index == 0 else np.full_like(first, 255),
            _tile(view.truth.before(_GREY)[window], _GREY),
            _tile(view.shown.before(_GREY)[window], _GREY),
            _tile(np.abs(view.shown.rgb - view.truth.rgb)[window], 0.0),
        ]
        captions = [
            f"input: {title}" if index == 0 else "",
            "photograph", f"render  {view.caption}", "difference",
        ]  # fmt: skip
        rows.append(np.hstack([_captioned(t, c) for t, c in zip(tiles, captions, strict=True)]))
    sheet: Image = np.vstack(rows)
    return sheet


def _around(mask: Mask) -> tuple[slice, slice]:
    """Rows and columns of the rectangle around a mask (H, W) and a margin of 4 % of its width."""
    rows, columns = np.flatnonzero(mask.any(axis=1)), np.flatnonzero(mask.any(axis=0))
    margin = 1 + int(0.04 * (columns[-1] - columns[0]))
    return (
        slice(max(int(rows[0]) - margin, 0), int(rows[-1]) + 1 + margin),
        slice(max(int(columns[0]) - margin, 0), int(columns[-1]) + 1 + margin),
    )


def _tile(image: Array, grey: float) -> Image:
    """An image (H, W, 3) in [0, 1] fitted into the middle of a tile of that grey."""
    height, width = image.shape[:2]
    scale = min(_WIDTH / width, _HEIGHT / height)
    size = (max(1, round(width * scale)), max(1, round(height * scale)))
    way = cv2.INTER_AREA if scale < 1 else cv2.INTER_LINEAR
    fitted = cv2.resize((image * 255).round().astype(np.uint8), size, interpolation=way)
    tile = np.full((_HEIGHT, _WIDTH, 3), round(grey * 255), np.uint8)
    left, top = (_WIDTH - size[0]) // 2, (_HEIGHT - size[1]) // 2
    tile[top : top + size[1], left : left + size[0]] = fitted
    return tile


def _captioned(tile: Image, caption: str) -> Image:
    """The tile under its caption of up to two lines, with a white edge."""
    sheet = np.full((_HEIGHT + _CAPTION + _GAP, _WIDTH + _GAP, 3), 255, np.uint8)
    sheet[_CAPTION : _CAPTION + _HEIGHT, :_WIDTH] = tile
    for line, text in enumerate(caption.split("\n")):
        cv2.putText(
            sheet, text, (4, 15 + 18 * line), cv2.FONT_HERSHEY_SIMPLEX, 0.45, (40, 40, 40), 1,
            cv2.LINE_AA,
        )  # fmt: skip
    return sheet
