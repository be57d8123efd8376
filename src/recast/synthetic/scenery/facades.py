"""Facades: walls with holes, what fills them, and their colours; set on the sides of a building."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from itertools import pairwise

import numpy as np

from recast.synthetic.scenery.primitives import PALETTES, SceneryPanels, at, choose
from recast.synthetic.surface import Surface

Colour = tuple[float, float, float]


@dataclass(frozen=True)
class FacadeLook:
    """Colours and habits shared by all openings of a facade.

    Attributes:
        wall: colour of the wall around them.
        wall_material: material of that wall.
        frame: colour of window frames.
        trim: colour of sills and surrounds.
        door: colour of doors.
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


class Facade(SceneryPanels):
    """A wall, x in [0, width], and what is on it.

    Args:
        rng: random generator for what differs from window to window.
        width: metres.
        look: look of the wall and its openings.
    """

    def __init__(self, rng: np.random.Generator, width: float, look: FacadeLook) -> None:
        super().__init__()
        self.rng, self.width, self.look = rng, width, look

    def wall(self, left: float, right: float, low: float, high: float) -> None:
        """A piece of the bare wall."""
        self.rect(left, right, low, high, 0.0, self.look.wall, self.look.wall_material)

    def storey(self, low: float, high: float, holes: Sequence[Opening]) -> None:
        """One storey of wall around its filled holes (from left to right, not overlapping)."""
        x = 0.0
        for hole in holes:
            self.wall(x, hole.left, low, high)
            self.wall(hole.left, hole.right, low, hole.low)
            self.wall(hole.left, hole.right, hole.high, high)
            x = hole.right
            if hole.kind != "none":
                self._fill(hole)
        self.wall(x, self.width, low, high)

    def reveal(self, hole: Opening, depth: float, colour: Colour, material: str) -> None:
        """The four sides of a hole, from the wall inwards."""
        a, b, low, high = hole.left, hole.right, hole.low, hole.high
        corners = [(a, low), (a, high), (b, high), (b, low)]
        for (x0, z0), (x1, z1) in zip(corners, corners[1:] + corners[:1], strict=True):
            side = [(x0, 0, z0), (x0, depth, z0), (x1, depth, z1), (x1, 0, z1)]
            self.polygon(side, 0.85 * np.asarray(colour), material)

    def bars(
        self, hole: Opening, y: float, width: float, lights: tuple[int, int], colour: Colour
    ) -> None:
        """A frame round the hole and the bars that part it into `lights` panes across and up."""
        a, b, low, high = hole.left, hole.right, hole.low, hole.high
        self.rect(a, b, low, low + width, y, colour, "plastic")
        self.rect(a, b, high - width, high, y, colour, "plastic")
        uprights = np.linspace(a, b, lights[0] + 1)
        for k, x in enumerate(uprights):
            start = x if k == 0 else (x - width if k == lights[0] else x - 0.4 * width)
            end = start + (width if k in (0, lights[0]) else 0.8 * width)
            self.rect(start, end, low + width, high - width, y, colour, "plastic")
        half = 0.3 * width
        for z in np.linspace(low, high, lights[1] + 1)[1:-1]:
            self.rect(a + width, b - width, z - half, z + half, y - 0.003, colour, "plastic")

    def _fill(self, hole: Opening) -> None:
        look = self.look
        self.reveal(hole, look.reveal, look.wall, look.wall_material)
        if hole.kind == "window":
            self._window(hole)
        elif hole.kind == "door":
            self._door(hole)
        else:
            y, shade = look.reveal, look.door
            self.rect(hole.left, hole.right, hole.low, hole.high, y, shade, "corrugated")

    def _window(self, hole: Opening) -> None:
        a, b, low, high = hole.left, hole.right, hole.low, hole.high
        rng, look = self.rng, self.look
        glass = choose(rng, "glass") * rng.uniform(0.7, 1.3)
        blind, y = high, look.reveal - 0.03
        if rng.random() < look.blinds:
            blind = high - (high - low) * rng.uniform(0.2, 0.75)
            self.rect(a, b, blind, high, look.reveal, choose(rng, "blinds"), "window")
        self.rect(a, b, low, blind, look.reveal, glass, "window")
        if look.lean:
            middle = 0.5 * (a + b)
            self.rect(middle - 0.04, middle + 0.04, low, high, y, look.frame, "plastic")
            for edge in (a, b - 0.07):
                self.rect(edge, edge + 0.07, low, high, y, look.frame, "plastic")
            self.rect(a - 0.06, b + 0.06, low - 0.08, low, -0.02, look.trim, "concrete")
        else:
            self.bars(hole, y, 0.075, look.lights, look.frame)
            sill = (a - 0.06, -0.06 - look.surround * 0.3, low - 0.07), (b + 0.06, y, low)
            self.box(*sill, look.trim, "concrete", "klr")
        s = look.surround
        if s > 0:
            self.rect(a - s, a, low, high, -0.025, look.trim, "concrete")
            self.rect(b, b + s, low, high, -0.025, look.trim, "concrete")
            self.rect(a - s, b + s, high, high + 1.3 * s, -0.025, look.trim, "concrete")

    def _door(self, hole: Opening) -> None:
        a, b, low, high = hole.left, hole.right, hole.low, hole.high
        look, y = self.look, self.look.reveal
        leaf = min(high, low + 2.1)
        self.rect(a, b, low, leaf, y, look.door, "wood")
        if high - leaf > 0.1:
            self.rect(a, b, leaf, high, y, PALETTES["glass"][0], "window")
            self.rect(a, b, leaf - 0.03, leaf + 0.04, y - 0.02, look.frame, "plastic")
        count = 2 if b - a > 1.3 else 1
        shade = 0.6 * np.asarray(look.door)
        for left, right in pairwise(np.linspace(a, b, count + 1)):
            start, end = left + 0.16 * (right - left), right - 0.16 * (right - left)
            for bottom, top in ((0.2, 0.8), (1.0, 1.85)):
                self.rect(start, end, low + bottom, low + top, y - 0.01, shade, "wood")
            knob = (right - 0.14, y - 0.07, low + 0.98), (right - 0.08, y, low + 1.08)
            self.box(*knob, (0.6, 0.5, 0.3), "metal", "k")
        self.bars(hole, y - 0.03, 0.06, (count, 1), look.frame)
        self.box((a - 0.2, -0.45, -0.3), (b + 0.2, 0.0, low), look.trim, "concrete", "bk")


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
    rng: np.random.Generator, width: float, edges: Sequence[float], look: FacadeLook, share: float
) -> SceneryPanels:
    """A side or back wall: small windows in a share of its bays, blank elsewhere.

    The windows are flat, a frame on the wall and glass on the frame: no road runs close to them.
    `width` is in metres; `edges` are the heights of the storeys' floors, and of the top.
    """
    panels = Facade(rng, width, look)
    panels.wall(0, width, edges[0], edges[-1])
    centres = bays(width, 3.4, 0.6)
    centres = centres[rng.random(len(centres)) < share]
    for floor, ceiling in pairwise(edges):
        low = max(floor, 0.0)
        high = low + min(2.2, 0.8 * (ceiling - low))
        for x in centres:
            glass = choose(rng, "glass") * rng.uniform(0.7, 1.3)
            panels.rect(x - 0.58, x + 0.58, low + 0.9, high, -0.02, look.frame, "plastic")
            for left in (x - 0.52, x + 0.03):
                panels.rect(left, left + 0.49, low + 0.96, high - 0.06, -0.025, glass, "window")
    return panels


def pick(rng: np.random.Generator, palette: str, spread: float = 0.12) -> Colour:
    """One colour of `PALETTES`, a little lighter or darker."""
    r, g, b = choose(rng, palette) * rng.uniform(1 - spread, 1 + spread)
    return float(r), float(g), float(b)


def scaled(colour: Colour, factor: float) -> Colour:
    """Lighter or darker."""
    r, g, b = (min(0.9, factor * channel) for channel in colour)
    return r, g, b


def around(
    width: float,
    depth: float,
    front: SceneryPanels,
    right: SceneryPanels,
    back: SceneryPanels,
    left: SceneryPanels,
) -> list[Surface]:
    """The facades, each drawn as if it were the front, on their sides of the building."""
    return [
        at(front.surface(), -width / 2, 0.0),
        at(right.surface(), width / 2, 0.0, 0.0, np.pi / 2),
        at(back.surface(), width / 2, depth, 0.0, np.pi),
        at(left.surface(), -width / 2, depth, 0.0, -np.pi / 2),
    ]
