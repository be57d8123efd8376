"""One picture a vehicle: the input, and for every reserved view photograph, render, difference."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import cv2
import numpy as np
from numpy.typing import NDArray

from recast.evaluation.actor_scores import Cutout, framed

Array = NDArray[np.float64]
Image = NDArray[np.uint8]

_TILE = 320  # pixels
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

    Tiles show the square around both vehicles before grey; the difference is the absolute one of
    the images before black, as they are scored.

    Args:
        title: of the input.
        source: the input.
        views: what it is compared on, at least one.
    """
    blank = _tile(np.ones((2, 2, 3)))
    first = _tile(source.before(_GREY)[framed(source.mask)])
    rows = []
    for index, view in enumerate(views):
        window = framed(view.truth.mask | view.shown.mask, margin=0.04)
        tiles = [
            first if index == 0 else blank,
            _tile(view.truth.before(_GREY)[window]),
            _tile(view.shown.before(_GREY)[window]),
            _tile(np.abs(view.shown.rgb - view.truth.rgb)[window]),
        ]
        captions = [
            f"input: {title}" if index == 0 else "",
            "photograph", f"render  {view.caption}", "difference",
        ]  # fmt: skip
        rows.append(np.hstack([_captioned(t, c) for t, c in zip(tiles, captions, strict=True)]))
    sheet: Image = np.vstack(rows)
    return sheet


def _tile(image: Array) -> Image:
    """An image (H, W, 3) in [0, 1] fitted into the middle of a square tile."""
    height, width = image.shape[:2]
    scale = _TILE / max(height, width)
    size = (max(1, round(width * scale)), max(1, round(height * scale)))
    way = cv2.INTER_AREA if scale < 1 else cv2.INTER_LINEAR
    fitted = cv2.resize((image * 255).round().astype(np.uint8), size, interpolation=way)
    tile = np.full((_TILE, _TILE, 3), 255, np.uint8)
    left, top = (_TILE - size[0]) // 2, (_TILE - size[1]) // 2
    tile[top : top + size[1], left : left + size[0]] = fitted
    return tile


def _captioned(tile: Image, caption: str) -> Image:
    """The tile under its caption, in lines of two words groups, with a white edge."""
    framed_tile = np.full((_TILE + _CAPTION + _GAP, _TILE + _GAP, 3), 255, np.uint8)
    framed_tile[_CAPTION : _CAPTION + _TILE, :_TILE] = tile
    for line, text in enumerate(caption.split("\n")):
        cv2.putText(
            framed_tile, text, (4, 15 + 18 * line), cv2.FONT_HERSHEY_SIMPLEX, 0.45, (40, 40, 40), 1,
            cv2.LINE_AA,
        )  # fmt: skip
    return framed_tile
