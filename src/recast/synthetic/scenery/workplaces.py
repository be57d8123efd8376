"""Buildings that people work in: sheds and workshops, and office blocks."""

from __future__ import annotations

from itertools import pairwise

import numpy as np

from recast.synthetic.scenery.facades import (
    Colour,
    Facade,
    FacadeLook,
    Opening,
    around,
    bays,
    pick,
    scaled,
    window_row,
)
from recast.synthetic.scenery.primitives import SceneryPanels
from recast.synthetic.scenery.roofs import flat_roof, gable_roof
from recast.synthetic.surface import Surface, concatenate

STRIP_GLASS: Colour = (0.05, 0.058, 0.062)
PANES = 310
"""At most on the whole building; panes get wider before there are more."""


def industrial(
    rng: np.random.Generator, width: float, depth: float, storeys: int | None
) -> Surface:
    """See `building`; a storey is 4 m."""
    top = 4.0 * storeys + 0.5 if storeys else rng.uniform(6.0, 10.5)
    plinth = rng.uniform(0.5, 2.2)
    cladding, accent = pick(rng, "shed_claddings"), pick(rng, "accents")
    base = pick(rng, "bricks") if rng.random() < 0.5 else (0.38, 0.37, 0.35)
    material = "brick" if base[0] > 1.5 * base[2] else "concrete"
    look = FacadeLook(
        cladding,
        "corrugated",
        frame=(0.12, 0.125, 0.13),
        trim=(0.4, 0.4, 0.4),
        door=pick(rng, "door_paints"),
        reveal=0.15,
        lean=True,
    )
    lower = FacadeLook(
        base, material, frame=look.frame, trim=look.trim, door=look.door, reveal=0.15
    )
    front = Facade(rng, width, look)
    _front(front, plinth, top, lower, accent)
    sides = [_side(rng, length, plinth, top, look, lower) for length in (depth, width, depth)]
    walls = around(width, depth, front, *sides)
    steel = (cladding, "corrugated")
    if rng.random() < 0.55:
        rise, tone = rng.uniform(0.06, 0.12) * depth, scaled(cladding, 0.8)
        roof = gable_roof((width, depth, rise), top, (0.3, 0.2), tone, steel, "corrugated")
    else:
        roof = flat_roof(rng, width, depth, top, 0.5, steel, accent)
    return concatenate([*walls, roof.surface()])


def _front(panels: Facade, plinth: float, top: float, lower: FacadeLook, accent: Colour) -> None:
    """Roller shutters, an office corner of two rows of windows, strip windows above, a sign."""
    rng, width, look = panels.rng, panels.width, panels.look
    gate = min(rng.uniform(3.6, 4.6), top - 1.5)
    office = min(rng.uniform(5.0, 9.0), 0.45 * width) if width > 9 else 0.0
    centres = bays(width - office, rng.uniform(5.5, 8.0), 0.6) + office
    step = (width - office) / len(centres)
    shut = rng.random(len(centres)) < 0.7
    holes = [
        Opening(x - min(2.0, 0.4 * step), x + min(2.0, 0.4 * step), 0.0, gate, "shutter")
        for x in centres[shut]
    ]
    if office:
        rows = window_row(bays(office, 1.7, 0.4), 1.25, 1.0, 2.2)
        middle = len(rows) // 2
        x = 0.5 * (rows[middle].left + rows[middle].right)
        rows[middle] = Opening(x - 0.55, x + 0.55, 0.1, 2.4, "door")
        holes = rows + holes
    # The plinth ends at the openings: lower walls between them, cladding above all.
    panels.look = lower if plinth > 1.6 else look
    panels.storey(-0.3, gate, holes)
    panels.look = look
    if plinth <= 1.6:
        edges = [0.0, *(x for h in holes for x in (h.left, h.right)), width]
        for a, b in zip(edges[::2], edges[1::2], strict=True):
            panels.rect(a, b, -0.3, min(plinth, 0.9), -0.05, lower.wall, lower.wall_material)
    upper: list[Opening] = []
    if office and top - gate > 2.2:
        upper += window_row(bays(office, 1.7, 0.4), 1.25, gate + 0.5, gate + 1.7)
    if top - gate > 2.6:
        strip = Opening(office + 0.6, width - 0.6, top - 1.7, top - 0.8, "none")
        upper.append(strip)
        count = max(2, round((strip.right - strip.left) / 2.0))
        for a, b in pairwise(np.linspace(strip.left, strip.right, count + 1)):
            glass = scaled(STRIP_GLASS, rng.uniform(0.6, 1.5))
            panels.rect(a + 0.05, b - 0.05, strip.low, strip.high, 0.1, glass, "window")
            panels.rect(b - 0.05, b + 0.05, strip.low, strip.high, 0.05, look.frame, "plastic")
    panels.storey(gate, top, upper)
    panels.box((0, -0.06, top - 0.5), (width, 0, top), accent, "corrugated", "k")
    for h in holes:
        if h.kind == "shutter":
            low, high = (h.left - 0.15, -0.25, gate), (h.right + 0.15, 0, gate + 0.35)
            panels.box(low, high, scaled(look.door, 0.8), "corrugated", "k")
            for x in (h.left - 0.2, h.right + 0.05):
                panels.box((x, -0.5, 0), (x + 0.15, -0.35, 1.0), (0.6, 0.42, 0.02), "plastic", "b")
    _sign(panels, top, accent)


def _sign(panels: Facade, top: float, accent: Colour) -> None:
    """The firm's name: a white board with blocks for letters."""
    rng = panels.rng
    wide = min(6.0, 0.3 * panels.width)
    x = rng.uniform(0.1, 0.85) * (panels.width - wide)
    low = top - 2.9 if top > 7.5 else top - 0.45
    high = low + (1.1 if top > 7.5 else 0.4)
    panels.box((x, -0.12, low), (x + wide, 0, high), (0.65, 0.65, 0.63), "plastic", "k")
    count = int(rng.integers(4, 9))
    pitch = 0.8 * wide / count
    for k in range(count):
        a = x + 0.1 * wide + k * pitch
        b, margin = a + 0.7 * pitch * rng.uniform(0.6, 1.0), 0.25 * (high - low)
        panels.rect(a, b, low + margin, high - margin, -0.125, accent, "plastic")


def _side(
    rng: np.random.Generator,
    width: float,
    plinth: float,
    top: float,
    look: FacadeLook,
    lower: FacadeLook,
) -> SceneryPanels:
    """Cladding over the plinth with strip windows, a shutter now and then, and downpipes."""
    panels = Facade(rng, width, lower)
    base, above = [], []
    if rng.random() < 0.5:
        x = rng.uniform(0.2, 0.6) * width
        end = min(x + 4.0, width - 0.5)
        base = [Opening(x, end, 0.0, plinth, "none")]
        above = [Opening(x, end, plinth, plinth + 2.4, "none")]
    panels.storey(-0.3, plinth, base)
    panels.look = look
    panels.storey(plinth, top, above)
    for h in above:
        panels.rect(h.left, h.right, 0.0, h.high, 0.12, look.door, "corrugated")
    for a in bays(width, 7.0, 1.0):
        glass = scaled(STRIP_GLASS, rng.uniform(0.6, 1.5))
        panels.rect(a - 1.5, a + 1.5, top - 1.6, top - 0.8, -0.02, glass, "window")
        panels.box((a - 2.6, -0.1, 0), (a - 2.5, 0, top), look.frame, "plastic", "btk")
    return panels


def office(rng: np.random.Generator, width: float, depth: float, storeys: int | None) -> Surface:
    """See `building`."""
    count = storeys or int(rng.integers(3, 8))
    ground, upper = rng.uniform(3.9, 4.8), rng.uniform(3.3, 3.8)
    edges = np.concatenate([[0.0], ground + upper * np.arange(count)])
    wall, tint = pick(rng, "office_claddings"), pick(rng, "tints", 0.25)
    form = ("bands", "curtain", "grid")[rng.integers(3)]
    frame = pick(rng, "mullions")
    pane = max(rng.uniform(1.4, 2.4), 2 * (width + depth) * count / PANES)
    look = FacadeLook(
        wall, "concrete", frame=frame, trim=scaled(wall, 1.15), reveal=0.3, lean=True, blinds=0.25
    )
    sides = []
    for k, length in enumerate((width, depth, width, depth)):
        side = Facade(rng, length, look)
        _ground(side, ground, tint, entrance=k == 0)
        for low, high in pairwise(edges[1:]):
            _storey(side, form, low, high, pane, tint, k == 0)
        if form == "curtain":
            # Upright bars in front of the glass.
            for x in np.linspace(0.06, length - 0.06, max(2, round(length / (2 * pane))) + 1):
                ends = (x - 0.05, -0.15, ground), (x + 0.05, 0, edges[-1])
                side.box(*ends, look.frame, "metal", "tk")
        sides.append(side)
    stone = (look.trim, "concrete")
    roof = flat_roof(rng, width, depth, edges[-1], rng.uniform(0.5, 1.1), stone, look.frame)
    return concatenate([*around(width, depth, *sides), roof.surface()])


def _ground(panels: Facade, high: float, tint: Colour, entrance: bool) -> None:
    """Tall glass between piers; the front has a canopy and doors."""
    rng, length, look = panels.rng, panels.width, panels.look
    panels.rect(0, length, -0.3, 0.25, 0.0, scaled(look.wall, 0.6), "concrete")
    panels.rect(0, length, high - 0.7, high, 0.0, look.trim, "concrete")
    z = high - 0.7
    soffit = [(0, 0.5, z), (length, 0.5, z), (length, 0, z), (0, 0, z)]
    panels.polygon(soffit, look.trim, "concrete")
    centres = bays(length, max(4.5, length / 7), 0.0)
    step = length / len(centres)
    for x in centres:
        shade = np.asarray(tint) * rng.uniform(0.6, 1.6)
        panels.rect(x - step / 2, x + step / 2, 0.25, high - 0.7, 0.4, shade, "window")
        panels.rect(x - 0.05, x + 0.05, 0.25, high - 0.7, 0.37, look.frame, "plastic")
    panels.rect(0, length, 2.5, 2.6, 0.36, look.frame, "plastic")
    for x in np.linspace(0.35, length - 0.35, len(centres) + 1):
        ends = (x - 0.35, -0.06, -0.3), (x + 0.35, 0.5, high - 0.7)
        panels.box(*ends, look.wall, "concrete", "btk")
    if entrance:
        x = centres[len(centres) // 2]
        panels.box((x - 2.2, -1.5, 2.9), (x + 2.2, 0.3, 3.15), look.frame, "metal")
        stair = (x - 1.7, -0.15, -0.3), (x + 1.7, 0.4, 0.12)
        panels.box(*stair, (0.35, 0.34, 0.33), "concrete", "bk")
        for a in (-1.0, 0.05):
            panels.rect(x + a, x + a + 0.95, 0.12, 2.45, 0.3, (0.05, 0.06, 0.065), "window")
            panels.rect(x + a + 0.85, x + a + 0.9, 0.9, 1.4, 0.26, (0.5, 0.5, 0.5), "metal")


def _storey(
    panels: Facade, form: str, low: float, high: float, pane: float, tint: Colour, front: bool
) -> None:
    rng, length, look = panels.rng, panels.width, panels.look
    if form == "grid":
        centres = bays(length, max(2.6, 1.9 * pane), 0.2)
        wide = 0.6 * (length - 0.4) / len(centres)
        holes = window_row(centres, wide, low + 0.75, high - 0.45)
        if front:
            panels.storey(low, high, holes)
            return
        panels.wall(0, length, low, high)
        for hole in holes:
            shade = np.asarray(tint) * rng.uniform(0.6, 1.5)
            panels.rect(hole.left, hole.right, hole.low, hole.high, -0.01, shade, "window")
        return
    if form == "bands":
        sill, back, top = low + 0.95, 0.25, high - 0.3
        panels.wall(0, length, low, sill)
        panels.wall(0, length, top, high)
        ledge = [(0, 0, sill), (length, 0, sill), (length, back, sill), (0, back, sill)]
        panels.polygon(ledge, look.trim, "concrete")
        soffit = [(0, back, top), (length, back, top), (length, 0, top), (0, 0, top)]
        panels.polygon(soffit, look.wall, "concrete")
    else:
        sill, back, top = low + 0.7, 0.02, high
        panels.rect(0, length, low, sill, 0.0, scaled(tint, 1.8), "window")
    edges = np.linspace(0, length, max(2, round(length / pane)) + 1)
    for a, b in pairwise(edges):
        shade = np.asarray(tint) * rng.uniform(0.6, 1.5)
        if rng.random() < 0.16:
            shade = shade + rng.uniform(0.05, 0.2)
        panels.rect(a, b - 0.08, sill, top, back, shade, "window")
        panels.rect(b - 0.08, b, sill, top, back - 0.01, look.frame, "plastic")
    panels.rect(0, length, sill - 0.05, sill + 0.03, back - 0.02, look.frame, "plastic")
