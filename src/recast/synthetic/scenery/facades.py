"""Facades: walls with holes, what fills them, and their colours; set on the sides of a building."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from itertools import pairwise

import numpy as np

from recast.synthetic.surface import PALETTES, SceneryPanels, Surface, at, choose

Colour = tuple[float, float, float]


@dataclass(frozen=True)
class FacadeLook:
    """Colours and habits shared by all openings of a facade."""

    wall: Colour  # colour of the wall around them
    wall_material: str  # material of that wall
    frame: Colour = (0.66, 0.66, 0.63)  # colour of window frames
    trim: Colour = (0.5, 0.48, 0.44)  # colour of sills and surrounds
    door: Colour = (0.08, 0.05, 0.035)  # colour of doors
    reveal: float = 0.14  # metres that glass lies behind the wall
    lights: tuple[int, int] = (2, 1)  # panes across and up of a window
    surround: float = 0.0  # metres of the band round windows, 0 for none
    blinds: float = 0.35  # share of windows with a blind or curtain half down
    lean: bool = False  # draws simpler frames, for facades of very many windows


@dataclass(frozen=True)
class Opening:
    """A hole in a wall, metres along it and above the ground."""

    # left, right, low, high: its edges.
    left: float
    right: float
    low: float
    high: float
    # "window", "door", "shutter" or "none" (an open hole that the caller fills).
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


FELT: Colour = (0.10, 0.10, 0.105)
IRON: Colour = (0.025, 0.027, 0.03)


def flat_roof(
    rng: np.random.Generator,
    width: float,
    depth: float,
    top: float,
    parapet: float,
    wall: tuple[Colour, str],
    coping: Colour,
) -> SceneryPanels:
    """A flat roof at `top` behind a parapet, with a stair head and ventilation boxes."""
    panels = SceneryPanels()
    half, edge = width / 2, 0.25
    panels.box((-half, 0, top - 0.05), (half, depth, top), FELT, "concrete", "bfklr")
    rim = top + parapet
    walls = (
        ((-half, 0), (half, edge)),
        ((-half, depth - edge), (half, depth)),
        ((-half, edge), (-half + edge, depth - edge)),
        ((half - edge, edge), (half, depth - edge)),
    )
    for (x0, y0), (x1, y1) in walls:
        panels.box((x0, y0, top), (x1, y1, rim - 0.08), *wall, "bt")
        stone = (x0 - 0.04, y0 - 0.04, rim - 0.08), (x1 + 0.04, y1 + 0.04, rim)
        panels.box(*stone, coping, "concrete")
    if width > 7 and depth > 7:
        for _ in range(int(rng.integers(1, 4))):
            w, d = rng.uniform(0.8, min(4.0, width / 3)), rng.uniform(0.8, 3.0)
            h = rng.uniform(0.7, 2.4)
            x = rng.uniform(-half + 1, half - 1 - w)
            y = rng.uniform(0.3 * depth, depth - 1 - d)
            grey = rng.uniform(0.2, 0.5)
            panels.box((x, y, top), (x + w, y + d, top + h), (grey,) * 3, "corrugated", "b")
    return panels


def gable_roof(
    size: tuple[float, float, float],
    low: float,
    out: tuple[float, float],
    colour: Colour,
    wall: tuple[Colour, str],
    material: str = "tiles",
) -> SceneryPanels:
    """A ridge along x over the middle, gable walls at the sides, slopes to the front and back.

    Args:
        size: width and depth of the walls, and rise from their top to the ridge, metres.
        low: height of the walls' top.
        out: metres that the roof stands out in front and behind, and at the sides.
        colour, material: colour and material of the roof.
        wall: colour and material of the gables.
    """
    panels = SceneryPanels()
    (width, depth, rise), (eaves, verge) = size, out
    half, middle = width / 2, depth / 2
    slope = rise / middle
    ridge, foot, thick = low + rise, low - eaves * slope, 0.16
    for x, outward in ((-half, -1), (half, 1)):
        gable = [(x, 0.0, low), (x, middle, ridge), (x, depth, low)]
        panels.polygon(gable if outward < 0 else gable[::-1], *wall)
    a, b = -half - verge, half + verge
    lift = np.array([0, 0, thick])
    front = np.array([(a, -eaves, foot), (b, -eaves, foot), (b, middle, ridge), (a, middle, ridge)])
    back = np.array(
        [(b, depth + eaves, foot), (a, depth + eaves, foot), (a, middle, ridge), (b, middle, ridge)]
    )
    fascia = (0.45, 0.44, 0.42)
    for slab in (front, back):
        panels.polygon((slab + lift).tolist(), colour, material)
        panels.polygon(slab[::-1].tolist(), 0.6 * np.asarray(fascia), "wood")
        for k in (0, 1, 3):
            p, q = slab[k], slab[(k + 1) % 4]
            panels.polygon([p, q, q + lift, p + lift], fascia, "wood")
    return panels


def hip_roof(
    size: tuple[float, float, float], low: float, eaves: float, colour: Colour
) -> SceneryPanels:
    """Slopes on all four sides; a pyramid over a square; `size` as of `gable_roof`."""
    panels = SceneryPanels()
    width, depth, rise = size
    half = width / 2 + eaves
    y0, y1 = -eaves, depth + eaves
    run = min(width, depth) / 2 + eaves
    foot = low - 0.05
    a, b, c, d = (-half, y0, foot), (half, y0, foot), (half, y1, foot), (-half, y1, foot)
    top, middle = low + rise, depth / 2
    if width >= depth:
        e, f = (-half + run, middle, top), (half - run, middle, top)
        slopes = [[a, b, f, e], [b, c, f], [c, d, e, f], [d, a, e]]
    else:
        e, f = (0.0, y0 + run, top), (0.0, y1 - run, top)
        slopes = [[a, b, e], [b, c, f, e], [c, d, f], [d, a, e, f]]
    for slope in slopes:
        distinct = [p for k, p in enumerate(slope) if not np.allclose(p, slope[k - 1])]
        panels.polygon(distinct, colour, "tiles")
    panels.box((-half, y0, foot - 0.18), (half, y1, foot), (0.45, 0.44, 0.42), "wood", "t")
    return panels


def mansard(
    size: tuple[float, float, float], low: float, colour: Colour, wall: tuple[Colour, str]
) -> SceneryPanels:
    """A steep tiled front and back up to a flat top, between party walls; as of `gable_roof`."""
    panels = SceneryPanels()
    width, depth, rise = size
    half, back = width / 2, 0.35 * rise
    top = low + rise
    end = depth - back
    front = [(-half, 0, low), (half, 0, low), (half, back, top), (-half, back, top)]
    rear = [(half, depth, low), (-half, depth, low), (-half, end, top), (half, end, top)]
    flat = [(-half, back, top), (half, back, top), (half, end, top), (-half, end, top)]
    panels.polygon(front, colour, "tiles")
    panels.polygon(rear, colour, "tiles")
    panels.polygon(flat, FELT, "concrete")
    for x, order in ((-half, -1), (half, 1)):
        side = [(x, 0, low), (x, depth, low), (x, depth - back, top), (x, back, top)]
        panels.polygon(side[::order], *wall)
    return panels


def chimney(
    panels: SceneryPanels, x: float, y: float, low: float, high: float, colour: Colour
) -> None:
    """A brick stack with two pots."""
    panels.box((x - 0.4, y - 0.25, low), (x + 0.4, y + 0.25, high), colour, "brick", "b")
    cap = (x - 0.46, y - 0.31, high - 0.15), (x + 0.46, y + 0.31, high)
    panels.box(*cap, 0.8 * np.asarray(colour), "concrete")
    for middle in (x - 0.2, x + 0.2):
        pot = (middle - 0.1, y - 0.1, high), (middle + 0.1, y + 0.1, high + 0.35)
        panels.box(*pot, (0.3, 0.12, 0.07), "matte", "b")


def cornice(facade: Facade, z: float, reach: float, height: float) -> None:
    """Two steps that stand out of the wall's top, the upper further."""
    middle, width, colour = z + 0.45 * height, facade.width, facade.look.trim
    facade.box((0, -0.5 * reach, z), (width, 0, middle), colour, "concrete", "tk")
    facade.box((0, -reach, middle), (width, 0, z + height), colour, "concrete", "k")


def course(facade: Facade, z: float) -> None:
    """A string course, a flat band across the facade."""
    ends = (0, -0.07, z - 0.1), (facade.width, 0, z + 0.12)
    facade.box(*ends, facade.look.trim, "concrete", "klr")


def balcony(panels: Facade, left: float, right: float, floor: float) -> None:
    """A slab with an iron railing, 1 m deep."""
    panels.box((left, -1.0, floor - 0.16), (right, 0, floor), panels.look.trim, "concrete", "k")
    top = floor + 1.0
    panels.box((left, -1.0, top - 0.05), (right, -0.95, top), IRON, "plastic")
    for x in (left, right - 0.05):
        panels.box((x, -0.95, top - 0.05), (x + 0.05, 0, top), IRON, "plastic", "fk")
    for x in np.linspace(left, right - 0.03, max(3, round((right - left) / 0.24))):
        panels.rect(x, x + 0.03, floor, top - 0.05, -0.975, IRON, "plastic")
    for y in (-0.65, -0.3):
        for x in (left + 0.02, right - 0.02):
            bar = [(x, y, floor), (x, y + 0.03, floor), (x, y + 0.03, top), (x, y, top)]
            panels.polygon(bar, IRON, "plastic")


def shop_front(panels: Facade, left: float, right: float, high: float) -> Opening:
    """Show windows, a door and a sign board; returns the hole that the wall must leave."""
    rng = panels.rng
    paint = choose(rng, "shop_paints") * rng.uniform(0.8, 1.2)
    board = rng.uniform(0.5, 0.75)
    hole = Opening(left, right, 0.0, high - board, "none")
    depth = 0.22
    panels.reveal(hole, depth, tuple(paint), "plastic")
    door = left + (right - left) * rng.choice([0.0, 0.35, 0.72])
    door_end = min(right, door + 1.1)
    riser = rng.uniform(0.3, 0.6)
    for a, b in ((left, door), (door_end, right)):
        if b - a > 0.2:
            _show_window(panels, Opening(a, b, riser, hole.high), depth, paint)
            panels.rect(a, b, 0.0, riser, depth - 0.04, 0.8 * paint, "plastic")
    entrance = Opening(door, door_end, 0.0, hole.high)
    panels.rect(door, door_end, 0.0, hole.high, depth + 0.01, PALETTES["glass"][0], "window")
    panels.bars(entrance, depth - 0.03, 0.08, (1, 1), tuple(paint))
    panels.rect(door, door_end, 2.1, 2.2, depth - 0.035, paint, "plastic")
    _sign_board(panels, left, right, hole.high, high, paint)
    if rng.random() < 0.35:
        _awning(panels, left, right, hole.high)
    return hole


def _show_window(panels: Facade, hole: Opening, depth: float, paint: np.ndarray) -> None:
    """Glass over goods: darker above, patches of colour below."""
    rng = panels.rng
    panes = max(1, round((hole.right - hole.left) / 1.5))
    edges = np.linspace(hole.left, hole.right, panes + 1)
    for a, b in pairwise(edges):
        split = hole.low + rng.uniform(0.25, 0.5) * (hole.high - hole.low)
        panels.rect(a, b, split, hole.high, depth, choose(rng, "glass") * 1.3, "window")
        goods = rng.uniform(0.04, 0.2) * (1 + 0.35 * rng.normal(0, 1, 3).clip(-1, 1))
        panels.rect(a, b, hole.low, split, depth, goods, "window")
    panels.bars(hole, depth - 0.03, 0.07, (panes, 1), tuple(paint))


def _sign_board(
    panels: Facade, left: float, right: float, low: float, high: float, paint: np.ndarray
) -> None:
    """The board over a shop with letters as blocks."""
    rng = panels.rng
    panels.box((left, -0.12, low), (right, 0, high), paint, "plastic", "k")
    ink = np.array([(0.7, 0.68, 0.6), (0.62, 0.5, 0.12), (0.75, 0.75, 0.75)])[rng.integers(3)]
    if paint.mean() > 0.25:
        ink = np.array((0.03, 0.03, 0.03))
    count = int(rng.integers(4, 10))
    pitch = min(0.34, 0.8 * (right - left) / count)
    x = 0.5 * (left + right - count * pitch)
    bottom, top = low + 0.28 * (high - low), low + 0.72 * (high - low)
    for k in range(count):
        a = x + k * pitch
        wide = pitch * rng.uniform(0.45, 0.75)
        stem = 0.3 * wide
        panels.rect(a, a + stem, bottom, top, -0.125, ink, "plastic")
        bar = rng.choice([bottom, 0.5 * (bottom + top), top - 0.06])
        panels.rect(a + stem, a + wide, bar, bar + 0.06, -0.125, ink, "plastic")
        if rng.random() < 0.5:
            panels.rect(a + wide - stem, a + wide, bottom, top, -0.125, ink, "plastic")


def _awning(panels: Facade, left: float, right: float, z: float) -> None:
    """Striped cloth that slopes out 1.2 m over the pavement."""
    first = choose(panels.rng, "shop_paints") * 1.3
    second = np.array((0.6, 0.58, 0.52))
    stripes = max(2, round((right - left) / 0.6))
    edges = np.linspace(left + 0.05, right - 0.05, stripes + 1)
    for k, (a, b) in enumerate(pairwise(edges)):
        colour = first if k % 2 else second
        top, out, drop = z + 0.1, z - 0.45, z - 0.65
        cloth = [(a, -1.2, out), (b, -1.2, out), (b, -0.13, top), (a, -0.13, top)]
        panels.polygon(cloth, colour, "fabric")
        panels.rect(a, b, drop, out, -1.2, colour, "fabric")
