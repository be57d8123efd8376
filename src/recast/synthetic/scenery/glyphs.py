"""Digits and a few letters as strokes, for signs that can be read."""

from __future__ import annotations

from itertools import pairwise

import numpy as np
from numpy.typing import NDArray

Array = NDArray[np.float64]

GLYPH_WIDTH = 0.6
"""Width of a glyph's centre lines as a share of its height."""


def _arc(cx: float, cy: float, rx: float, ry: float, start: float, end: float) -> list[list[float]]:
    """Points on an ellipse from one angle to another, degrees counter-clockwise from +u."""
    steps = max(2, round(abs(end - start) / 30))
    angle = np.deg2rad(np.linspace(start, end, steps + 1))
    return np.column_stack([cx + rx * np.cos(angle), cy + ry * np.sin(angle)]).tolist()


_UPPER = (0.3, 0.74, 0.27, 0.26)
_LOWER = (0.3, 0.27, 0.3, 0.27)
STROKES: dict[str, list[list[list[float]]]] = {
    "0": [_arc(0.3, 0.5, 0.3, 0.5, 0, 360)],
    "1": [[[0.1, 0.78], [0.36, 1.0], [0.36, 0.0]]],
    "2": [[*_arc(0.3, 0.72, 0.3, 0.28, 170, -30), [0.0, 0.0], [0.6, 0.0]]],
    "3": [_arc(*_UPPER, 160, -90), _arc(*_LOWER, 90, -160)],
    "4": [[[0.45, 0.0], [0.45, 1.0], [0.0, 0.3], [0.62, 0.3]]],
    "5": [[[0.55, 1.0], [0.08, 1.0], [0.04, 0.52], *_arc(0.28, 0.31, 0.32, 0.31, 120, -150)]],
    "6": [[[0.5, 0.97], *_arc(0.42, 0.4, 0.42, 0.57, 110, 180)], _arc(*_LOWER, 0, 360)],
    "7": [[[0.0, 1.0], [0.6, 1.0], [0.22, 0.0]]],
    "8": [_arc(*_UPPER, 0, 360), _arc(*_LOWER, 0, 360)],
    "9": [_arc(0.3, 0.72, 0.3, 0.28, 0, 360), [[0.6, 0.72], *_arc(0.2, 0.6, 0.4, 0.58, 0, -80)]],
    "O": [_arc(0.3, 0.5, 0.32, 0.5, 0, 360)],
    "P": [[[0.03, 0.0], [0.03, 1.0], *_arc(0.3, 0.74, 0.3, 0.26, 90, -90), [0.03, 0.48]]],
    "S": [[*_arc(0.3, 0.75, 0.28, 0.25, 30, 270), *_arc(0.3, 0.25, 0.3, 0.25, 90, -150)]],
    "T": [[[0.0, 1.0], [0.6, 1.0]], [[0.3, 1.0], [0.3, 0.0]]],
    "!": [[[0.3, 1.0], [0.3, 0.35]], [[0.3, 0.1], [0.3, 0.02]]],
    "^": [[[0.3, 0.0], [0.3, 1.0]], [[0.0, 0.62], [0.3, 1.0], [0.6, 0.62]]],
    "<": [[[0.62, 0.5], [0.0, 0.5]], [[0.3, 0.85], [0.0, 0.5], [0.3, 0.15]]],
    ">": [[[0.0, 0.5], [0.62, 0.5]], [[0.3, 0.85], [0.62, 0.5], [0.3, 0.15]]],
}


def text_quads(text: str, height: float, weight: float = 0.17) -> Array:
    """Flat four-sided pieces that draw a text, centred at the origin.

    Args:
        text: of the characters in `STROKES`.
        height: metres.
        weight: thickness of the strokes as a share of the height.

    Returns:
        (N, 4, 2) metres, u to the reader's right, v up, counter-clockwise.
    """
    advance = GLYPH_WIDTH + 2.2 * weight
    first = -(len(text) * advance - 1.2 * weight - weight) / 2
    inner = 1.0 - weight
    pieces = []
    for k, character in enumerate(text):
        for stroke in STROKES[character]:
            points = np.asarray(stroke) * [1.0, inner] + [first + k * advance, -inner / 2]
            pieces += [_segment(a, b, weight / 2) for a, b in pairwise(points)]
    return np.stack(pieces) * height


def _segment(a: Array, b: Array, half: float) -> Array:
    """A bar from a to b, a little longer than that so that bends have no gaps."""
    along = (b - a) / np.linalg.norm(b - a)
    across = half * np.array([-along[1], along[0]])
    a, b = a - 0.45 * half * along, b + 0.45 * half * along
    return np.stack([a - across, b - across, b + across, a + across])
