"""Advertising boards."""

from __future__ import annotations

from itertools import pairwise

import numpy as np

from recast.synthetic.scenery.arguments import require_size
from recast.synthetic.scenery.panels import Panels
from recast.synthetic.surface import Surface

FRAME = (0.06, 0.065, 0.07)
POSTERS = np.array(
    [
        [(0.02, 0.10, 0.38), (0.70, 0.70, 0.66), (0.75, 0.40, 0.02)],
        [(0.60, 0.05, 0.03), (0.72, 0.70, 0.62), (0.04, 0.04, 0.05)],
        [(0.70, 0.55, 0.08), (0.05, 0.05, 0.06), (0.50, 0.05, 0.04)],
        [(0.68, 0.68, 0.66), (0.03, 0.16, 0.10), (0.30, 0.55, 0.12)],
        [(0.05, 0.30, 0.36), (0.72, 0.70, 0.60), (0.70, 0.22, 0.10)],
        [(0.08, 0.03, 0.14), (0.70, 0.60, 0.66), (0.65, 0.10, 0.30)],
    ]
)
"""Ground, lettering and picture of each poster."""


def hoarding(rng: np.random.Generator, width: float = 6.0, height: float = 3.0) -> Surface:
    """An advertising board on legs, facing -y, centred at x = 0; its lower edge 2.2 to 3 m up.

    Args:
        rng: chooses the poster and how high it stands.
        width, height: metres of the board, 1 to 20 and 0.8 to 10.

    Raises:
        InputError: for impossible sizes.
    """
    require_size("hoarding", "width", width, 1.0, 20.0)
    require_size("hoarding", "height", height, 0.8, 10.0)
    low = rng.uniform(2.2, 3.0)
    half, top = width / 2, low + height
    panels = Panels()
    panels.box((-half, -0.1, low), (half, 0.1, top), FRAME, "plastic")
    edge = min(0.12, 0.05 * width)
    _poster(panels, rng, -half + edge, half - edge, low + edge, top - edge)
    legs = max(2, round(width / 3.5))
    for x in np.linspace(-0.7 * half, 0.7 * half, legs):
        panels.box((x - 0.1, 0.1, -0.4), (x + 0.1, 0.3, top - 0.2), (0.2, 0.21, 0.22), "metal", "b")
        brace = [(x - 0.05, 1.3, 0.0), (x + 0.05, 1.3, 0.0), (x + 0.05, 0.3, low + 0.6 * height)]
        panels.polygon([*brace, (x - 0.05, 0.3, low + 0.6 * height)], (0.2, 0.21, 0.22), "metal")
    panels.box((-half, -0.75, low - 0.1), (half, 0.1, low - 0.05), (0.16, 0.165, 0.17), "metal")
    for x in np.linspace(-0.6 * half, 0.6 * half, legs):
        panels.box(
            (x - 0.02, -0.7, low - 0.05), (x + 0.02, -0.66, low + 0.2), FRAME, "plastic", "b"
        )
        panels.box((x - 0.15, -0.78, low + 0.2), (x + 0.15, -0.6, low + 0.28), FRAME, "plastic")
    return panels.surface()


def _poster(
    panels: Panels, rng: np.random.Generator, left: float, right: float, low: float, high: float
) -> None:
    """Ground in shaded bands, a round or slanted picture on one side, lines of lettering beside."""
    ground, ink, picture = POSTERS[rng.integers(len(POSTERS))] * rng.uniform(0.85, 1.1)
    width, height = right - left, high - low
    edges = np.linspace(low, high, 7)
    for k, (a, b) in enumerate(pairwise(edges)):
        panels.rect(
            left, right, a, b, -0.105, np.clip(ground * (0.8 + 0.07 * k), 0, 0.9), "plastic"
        )
    mirrored = rng.random() < 0.5
    radius = 0.38 * min(height, 0.55 * width)
    cx = right - 1.25 * radius if mirrored else left + 1.25 * radius
    cz = low + height * rng.uniform(0.45, 0.55)
    for k, scale in enumerate((1.0, 0.72, 0.4)):
        sides = 18 if rng.random() < 0.7 else 4
        angle = 2 * np.pi * np.arange(sides) / sides + (0.3 if sides == 4 else 0)
        x, z = cx + scale * radius * np.cos(angle), cz + scale * radius * np.sin(angle)
        colour = (picture, ink, 0.6 * picture)[k]
        y = np.full(sides, -0.11 - 0.005 * k)
        panels.polygon(np.column_stack([x, y, z]).tolist(), colour, "plastic")
    start = left + 0.08 * width if mirrored else cx + 1.4 * radius
    end = cx - 1.4 * radius if mirrored else right - 0.08 * width
    line = high - 0.2 * height
    for k in range(3):
        size = (0.2, 0.09, 0.09)[k] * height
        pen, stop = start, start + (end - start) * rng.uniform(0.65, 1.0)
        while pen < stop - 0.3 * size:
            wide = size * rng.uniform(0.35, 0.75)
            panels.rect(pen, min(pen + wide, end), line - size, line, -0.11, ink, "plastic")
            pen += wide + 0.18 * size
        line -= size + 0.08 * height
