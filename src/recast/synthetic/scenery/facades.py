"""Facades: walls with holes, what fills them, and their colours; set on the sides of a building."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from itertools import pairwise

import numpy as np

from recast.synthetic.scenery.primitives import Panels, at
from recast.synthetic.surface import Surface

Colour = tuple[float, float, float]

GLASS = np.array(
    [(0.020, 0.025, 0.030), (0.035, 0.040, 0.042), (0.014, 0.016, 0.020), (0.05, 0.05, 0.045)]
)
"""Rooms behind windows, as seen by day."""
BLINDS = np.array([(0.48, 0.46, 0.40), (0.40, 0.36, 0.30), (0.52, 0.52, 0.50), (0.3, 0.24, 0.2)])
BRICKS = np.array(
    [
        (0.31, 0.12, 0.075),
        (0.40, 0.20, 0.12),
        (0.24, 0.115, 0.085),
        (0.48, 0.37, 0.25),
        (0.36, 0.155, 0.09),
    ]
)
PLASTERS = np.array(
    [
        (0.60, 0.55, 0.45),
        (0.56, 0.46, 0.30),
        (0.64, 0.62, 0.58),
        (0.50, 0.34, 0.26),
        (0.42, 0.46, 0.43),
        (0.58, 0.42, 0.33),
        (0.38, 0.43, 0.49),
        (0.66, 0.60, 0.44),
        (0.46, 0.44, 0.42),
    ]
)
BOARDS = np.array([(0.62, 0.62, 0.60), (0.30, 0.37, 0.44), (0.58, 0.51, 0.33), (0.33, 0.38, 0.31)])
FRAMES = np.array(
    [
        (0.68, 0.68, 0.66),
        (0.68, 0.68, 0.66),
        (0.05, 0.05, 0.055),
        (0.16, 0.09, 0.05),
        (0.10, 0.14, 0.13),
    ]
)
DOORS = np.array(
    [
        (0.20, 0.02, 0.02),
        (0.02, 0.06, 0.12),
        (0.03, 0.09, 0.05),
        (0.10, 0.055, 0.03),
        (0.02, 0.02, 0.022),
        (0.40, 0.27, 0.05),
    ]
)


@dataclass(frozen=True)
class Look:
    """Colours and habits shared by all openings of a facade.

    Attributes:
        wall, wall_material: of the wall around them.
        frame: of window frames.
        trim: of sills and surrounds.
        door: of doors.
        reveal: metres that glass lies behind the wall.
        lights: panes across and up of a window.
        surround: metres of the band round windows, 0 for none.
        blinds: share of windows with a blind or curtain half down.
        lean: draws simpler frames, for facades of very many windows.
    """

    wall: Colour
    wall_material: str
    frame: Colour = (0.66, 0.66, 0.63)
    trim: Colour = (0.5, 0.48, 0.44)
    door: Colour = (0.08, 0.05, 0.035)
    reveal: float = 0.14
    lights: tuple[int, int] = (2, 1)
    surround: float = 0.0
    blinds: float = 0.35
    lean: bool = False


@dataclass(frozen=True)
class Opening:
    """A hole in a wall, metres along it and above the ground.

    Attributes:
        left, right, low, high: its edges.
        kind: "window", "door", "shutter" or "none" (an open hole that the caller fills).
    """

    left: float
    right: float
    low: float
    high: float
    kind: str = "window"


def reveal(panels: Panels, hole: Opening, depth: float, colour: Colour, material: str) -> None:
    """The four sides of a hole, from the wall inwards."""
    a, b, low, high = hole.left, hole.right, hole.low, hole.high
    shade = 0.85 * np.asarray(colour)
    panels.polygon([(a, 0, low), (a, depth, low), (a, depth, high), (a, 0, high)], shade, material)
    panels.polygon([(b, depth, low), (b, 0, low), (b, 0, high), (b, depth, high)], shade, material)
    panels.polygon([(a, 0, low), (b, 0, low), (b, depth, low), (a, depth, low)], shade, material)
    panels.polygon(
        [(a, depth, high), (b, depth, high), (b, 0, high), (a, 0, high)], shade, material
    )


def fill(panels: Panels, rng: np.random.Generator, hole: Opening, look: Look) -> None:
    """Draw what belongs in the hole, with its reveal."""
    reveal(panels, hole, look.reveal, look.wall, look.wall_material)
    if hole.kind == "window":
        _window(panels, rng, hole, look)
    elif hole.kind == "door":
        _door(panels, hole, look)
    elif hole.kind == "shutter":
        shade = np.asarray(look.door)
        panels.rect(hole.left, hole.right, hole.low, hole.high, look.reveal, shade, "corrugated")


def bars(
    panels: Panels, hole: Opening, y: float, width: float, lights: tuple[int, int], colour: Colour
) -> None:
    """A frame round the hole and the bars that part it into `lights` panes across and up."""
    a, b, low, high = hole.left, hole.right, hole.low, hole.high
    panels.rect(a, b, low, low + width, y, colour, "plastic")
    panels.rect(a, b, high - width, high, y, colour, "plastic")
    uprights = np.linspace(a, b, lights[0] + 1)
    for k, x in enumerate(uprights):
        start = x if k == 0 else (x - width if k == lights[0] else x - 0.4 * width)
        end = start + (width if k in (0, lights[0]) else 0.8 * width)
        panels.rect(start, end, low + width, high - width, y, colour, "plastic")
    for z in np.linspace(low, high, lights[1] + 1)[1:-1]:
        panels.rect(
            a + width, b - width, z - 0.3 * width, z + 0.3 * width, y - 0.003, colour, "plastic"
        )


def _window(panels: Panels, rng: np.random.Generator, hole: Opening, look: Look) -> None:
    a, b, low, high = hole.left, hole.right, hole.low, hole.high
    glass = GLASS[rng.integers(len(GLASS))] * rng.uniform(0.7, 1.3)
    blind = high
    if rng.random() < look.blinds:
        blind = high - (high - low) * rng.uniform(0.2, 0.75)
        panels.rect(a, b, blind, high, look.reveal, BLINDS[rng.integers(len(BLINDS))], "window")
    panels.rect(a, b, low, blind, look.reveal, glass, "window")
    if look.lean:
        middle = 0.5 * (a + b)
        y = look.reveal - 0.03
        panels.rect(middle - 0.04, middle + 0.04, low, high, y, look.frame, "plastic")
        for edge in (a, b - 0.07):
            panels.rect(edge, edge + 0.07, low, high, y, look.frame, "plastic")
        panels.rect(a - 0.06, b + 0.06, low - 0.08, low, -0.02, look.trim, "concrete")
    else:
        bars(panels, hole, look.reveal - 0.03, 0.075, look.lights, look.frame)
        out = 0.06 + look.surround * 0.3
        panels.box(
            (a - 0.06, -out, low - 0.07),
            (b + 0.06, look.reveal - 0.03, low),
            look.trim,
            "concrete",
            "klr",
        )
    if look.surround > 0:
        s = look.surround
        for left, right, bottom, top in (
            (a - s, a, low, high),
            (b, b + s, low, high),
            (a - s, b + s, high, high + 1.3 * s),
        ):
            panels.rect(left, right, bottom, top, -0.025, look.trim, "concrete")


def _door(panels: Panels, hole: Opening, look: Look) -> None:
    a, b, low, high = hole.left, hole.right, hole.low, hole.high
    leaf = min(high, low + 2.1)
    y = look.reveal
    panels.rect(a, b, low, leaf, y, look.door, "wood")
    if high - leaf > 0.1:
        panels.rect(a, b, leaf, high, y, GLASS[0], "window")
        panels.rect(a, b, leaf - 0.03, leaf + 0.04, y - 0.02, look.frame, "plastic")
    count = 2 if b - a > 1.3 else 1
    edges = np.linspace(a, b, count + 1)
    for left, right in pairwise(edges):
        inset = 0.16 * (right - left)
        for bottom, top in ((0.2, 0.8), (1.0, 1.85)):
            shade = 0.6 * np.asarray(look.door)
            panels.rect(
                left + inset, right - inset, low + bottom, low + top, y - 0.01, shade, "wood"
            )
        panels.box(
            (right - 0.14, y - 0.07, low + 0.98),
            (right - 0.08, y, low + 1.08),
            (0.6, 0.5, 0.3),
            "metal",
            "k",
        )
    bars(panels, Opening(a, b, low, high), y - 0.03, 0.06, (count, 1), look.frame)
    panels.box((a - 0.2, -0.45, -0.3), (b + 0.2, 0.0, low), look.trim, "concrete", "bk")


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


def pick(rng: np.random.Generator, palette: np.ndarray, spread: float = 0.12) -> Colour:
    """One colour of a palette, a little lighter or darker."""
    r, g, b = palette[rng.integers(len(palette))] * rng.uniform(1 - spread, 1 + spread)
    return float(r), float(g), float(b)


def scaled(colour: Colour, factor: float) -> Colour:
    """Lighter or darker."""
    r, g, b = (min(0.9, factor * channel) for channel in colour)
    return r, g, b


def around(
    width: float, depth: float, front: Panels, right: Panels, back: Panels, left: Panels
) -> list[Surface]:
    """The facades, each drawn as if it were the front, on their sides of the building."""
    return [
        at(front.surface(), -width / 2, 0.0),
        at(right.surface(), width / 2, 0.0, 0.0, np.pi / 2),
        at(back.surface(), width / 2, depth, 0.0, np.pi),
        at(left.surface(), -width / 2, depth, 0.0, -np.pi / 2),
    ]
