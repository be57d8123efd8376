"""Walls with holes, storey by storey."""

from __future__ import annotations

from collections.abc import Sequence
from itertools import pairwise

import numpy as np

from recast.synthetic.scenery.openings import GLASS, Look, Opening, fill
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

    The windows are flat, a frame on the wall and glass on the frame: no road runs close to them.

    Args:
        rng: chooses where windows are.
        width: metres.
        edges: heights of the storeys' floors, and of the top.
        look: of the wall and the frames.
        chance: share of bays with a window.
    """
    panels = Panels()
    panels.rect(0, width, edges[0], edges[-1], 0.0, look.wall, look.wall_material)
    centres = bays(width, 3.4, 0.6)
    centres = centres[rng.random(len(centres)) < chance]
    for floor, ceiling in pairwise(edges):
        low = max(floor, 0.0)
        high = low + min(2.2, 0.8 * (ceiling - low))
        for x in centres:
            glass = GLASS[rng.integers(len(GLASS))] * rng.uniform(0.7, 1.3)
            panels.rect(x - 0.58, x + 0.58, low + 0.9, high, -0.02, look.frame, "plastic")
            for left in (x - 0.52, x + 0.03):
                panels.rect(left, left + 0.49, low + 0.96, high - 0.06, -0.025, glass, "window")
    return panels
