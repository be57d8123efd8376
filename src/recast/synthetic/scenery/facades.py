"""Walls with holes, storey by storey."""

from __future__ import annotations

import itertools
from collections.abc import Sequence

import numpy as np

from recast.synthetic.scenery.openings import Look, Opening, fill
from recast.synthetic.scenery.panels import Panels


def wall_storey(
    panels: Panels,
    rng: np.random.Generator,
    width: float,
    low: float,
    high: float,
    holes: Sequence[Opening],
    look: Look,
) -> None:
    """One storey of wall, x in [0, width] and z in [low, high], around its filled holes.

    Args:
        panels: drawn on.
        rng: for what differs from window to window.
        width, low, high: metres.
        holes: from left to right, not overlapping, within the storey.
        look: of the wall and its openings.
    """
    x = 0.0
    for hole in holes:
        panels.rect(x, hole.left, low, high, 0.0, look.wall, look.wall_material)
        panels.rect(hole.left, hole.right, low, hole.low, 0.0, look.wall, look.wall_material)
        panels.rect(hole.left, hole.right, hole.high, high, 0.0, look.wall, look.wall_material)
        x = hole.right
        if hole.kind != "none":
            fill(panels, rng, hole, look)
    panels.rect(x, width, low, high, 0.0, look.wall, look.wall_material)


def window_row(
    centres: np.ndarray, width: float, low: float, high: float, kind: str = "window"
) -> list[Opening]:
    """Equal openings about the given centres."""
    return [Opening(x - width / 2, x + width / 2, low, high, kind) for x in centres]


def bays(width: float, bay: float, margin: float) -> np.ndarray:
    """Centres of equal bays of about `bay` metres that fill a wall but its margins."""
    count = max(1, round((width - 2 * margin) / bay))
    step = (width - 2 * margin) / count
    return margin + step * (np.arange(count) + 0.5)


def plain_wall(
    rng: np.random.Generator, width: float, edges: Sequence[float], look: Look, chance: float
) -> Panels:
    """A side or back wall: small windows in some places, blank elsewhere.

    Args:
        rng: chooses where windows are.
        width: metres.
        edges: heights of the storeys' floors, and of the top.
        look: of the wall; its openings are drawn lean.
        chance: share of bays with a window.
    """
    panels = Panels()
    centres = bays(width, 3.4, 0.6)
    column = rng.random(len(centres)) < chance
    for low, high in itertools.pairwise(edges):
        tall = min(1.35, 0.5 * (high - low))
        sill = max(low, 0.0) + 0.3 * (high - max(low, 0.0))
        holes = window_row(centres[column], 1.0, sill, sill + tall) if high - low > 2 else []
        wall_storey(panels, rng, width, low, high, holes, look)
    return panels
