"""Sheds and workshops: cladding over a plinth, roller shutters, strip windows, low roofs."""

from __future__ import annotations

from itertools import pairwise

import numpy as np

from recast.synthetic.scenery.facades import bays, wall_storey, window_row
from recast.synthetic.scenery.openings import Colour, Look, Opening
from recast.synthetic.scenery.panels import Panels
from recast.synthetic.scenery.roofs import flat_roof, gable_roof
from recast.synthetic.scenery.walls import BRICKS, around, pick, scaled
from recast.synthetic.surface import Surface, concatenate

CLADDINGS = np.array(
    [
        (0.42, 0.44, 0.45),
        (0.52, 0.52, 0.50),
        (0.18, 0.24, 0.30),
        (0.26, 0.32, 0.27),
        (0.50, 0.46, 0.37),
        (0.13, 0.14, 0.15),
    ]
)
ACCENTS = np.array(
    [
        (0.03, 0.10, 0.30),
        (0.35, 0.03, 0.025),
        (0.04, 0.18, 0.09),
        (0.5, 0.22, 0.02),
        (0.06, 0.065, 0.07),
    ]
)
STRIP_GLASS: Colour = (0.05, 0.058, 0.062)
DOOR_PAINTS = np.array(
    [(0.45, 0.46, 0.47), (0.05, 0.12, 0.28), (0.30, 0.06, 0.04), (0.5, 0.48, 0.42)]
)


def industrial(
    rng: np.random.Generator, width: float, depth: float, storeys: int | None
) -> Surface:
    """See `building`; a storey is 4 m."""
    top = 4.0 * storeys + 0.5 if storeys else rng.uniform(6.0, 10.5)
    plinth = rng.uniform(0.5, 2.2)
    cladding, accent = pick(rng, CLADDINGS), pick(rng, ACCENTS)
    base = pick(rng, BRICKS) if rng.random() < 0.5 else (0.38, 0.37, 0.35)
    material = "brick" if base[0] > 1.5 * base[2] else "concrete"
    look = Look(
        cladding,
        "corrugated",
        frame=(0.12, 0.125, 0.13),
        trim=(0.4, 0.4, 0.4),
        door=pick(rng, DOOR_PAINTS),
        reveal=0.15,
        lean=True,
    )
    lower = Look(base, material, frame=look.frame, trim=look.trim, door=look.door, reveal=0.15)
    front = Panels()
    _front(front, rng, width, plinth, top, look, lower, accent)
    sides = [_side(rng, length, plinth, top, look, lower) for length in (depth, width, depth)]
    walls = around(width, depth, front, *sides)
    roof = Panels()
    if rng.random() < 0.55:
        gable_roof(
            roof,
            width,
            depth,
            top,
            rng.uniform(0.06, 0.12) * depth,
            0.3,
            0.2,
            scaled(cladding, 0.8),
            cladding,
            "corrugated",
            "corrugated",
        )
    else:
        flat_roof(roof, rng, width, depth, top, 0.5, cladding, "corrugated", accent)
    return concatenate([*walls, roof.surface()])


def _front(
    panels: Panels,
    rng: np.random.Generator,
    width: float,
    plinth: float,
    top: float,
    look: Look,
    lower: Look,
    accent: Colour,
) -> None:
    """Roller shutters, an office corner of two rows of windows, strip windows above, a sign."""
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
    split = [Opening(h.left, h.right, h.low, h.high, h.kind) for h in holes]
    wall_storey(panels, rng, width, -0.3, gate, split, lower if plinth > 1.6 else look)
    if plinth <= 1.6:
        edges = [0.0, *(x for h in holes for x in (h.left, h.right)), width]
        for a, b in zip(edges[::2], edges[1::2], strict=True):
            panels.rect(a, b, -0.3, min(plinth, 0.9), -0.05, lower.wall, lower.wall_material)
    upper: list[Opening] = []
    if office and top - gate > 2.2:
        upper += window_row(bays(office, 1.7, 0.4), 1.25, gate + 0.5, gate + 1.7)
    if top - gate > 2.6:
        upper += [Opening(office + 0.6, width - 0.6, top - 1.7, top - 0.8, "none")]
        strip = upper[-1]
        panes = np.linspace(
            strip.left, strip.right, max(2, round((strip.right - strip.left) / 2.0)) + 1
        )
        for a, b in pairwise(panes):
            panels.rect(
                a + 0.05,
                b - 0.05,
                strip.low,
                strip.high,
                0.1,
                scaled(STRIP_GLASS, rng.uniform(0.6, 1.5)),
                "window",
            )
            panels.rect(b - 0.05, b + 0.05, strip.low, strip.high, 0.05, look.frame, "plastic")
    wall_storey(panels, rng, width, gate, top, upper, look)
    panels.box((0, -0.06, top - 0.5), (width, 0, top), accent, "corrugated", "k")
    for h in holes:
        if h.kind == "shutter":
            panels.box(
                (h.left - 0.15, -0.25, gate),
                (h.right + 0.15, 0, gate + 0.35),
                scaled(look.door, 0.8),
                "corrugated",
                "k",
            )
            for x in (h.left - 0.2, h.right + 0.05):
                panels.box((x, -0.5, 0), (x + 0.15, -0.35, 1.0), (0.6, 0.42, 0.02), "plastic", "b")
    _sign(panels, rng, width, top, accent)


def _sign(
    panels: Panels, rng: np.random.Generator, width: float, top: float, accent: Colour
) -> None:
    """The firm's name: a white board with blocks for letters."""
    wide = min(6.0, 0.3 * width)
    x = rng.uniform(0.1, 0.85) * (width - wide)
    low = top - 2.9 if top > 7.5 else top - 0.45
    high = low + (1.1 if top > 7.5 else 0.4)
    panels.box((x, -0.12, low), (x + wide, 0, high), (0.65, 0.65, 0.63), "plastic", "k")
    count = int(rng.integers(4, 9))
    pitch = 0.8 * wide / count
    for k in range(count):
        a = x + 0.1 * wide + k * pitch
        panels.rect(
            a,
            a + 0.7 * pitch * rng.uniform(0.6, 1.0),
            low + 0.25 * (high - low),
            high - 0.25 * (high - low),
            -0.125,
            accent,
            "plastic",
        )


def _side(
    rng: np.random.Generator, width: float, plinth: float, top: float, look: Look, lower: Look
) -> Panels:
    """Cladding over the plinth with strip windows, a shutter now and then, and downpipes."""
    panels = Panels()
    holes = []
    if rng.random() < 0.5:
        x = rng.uniform(0.2, 0.6) * width
        holes = [Opening(x, min(x + 4.0, width - 0.5), 0.0, plinth + 2.4, "shutter")]
    base = [Opening(h.left, h.right, 0.0, plinth, "none") for h in holes]
    wall_storey(panels, rng, width, -0.3, plinth, base, lower)
    above = [Opening(h.left, h.right, plinth, h.high, "none") for h in holes]
    wall_storey(panels, rng, width, plinth, top, above, look)
    for h in holes:
        panels.rect(h.left, h.right, 0.0, h.high, 0.12, look.door, "corrugated")
    for a in bays(width, 7.0, 1.0):
        panels.rect(
            a - 1.5,
            a + 1.5,
            top - 1.6,
            top - 0.8,
            -0.02,
            scaled(STRIP_GLASS, rng.uniform(0.6, 1.5)),
            "window",
        )
        panels.box((a - 2.6, -0.1, 0), (a - 2.5, 0, top), look.frame, "plastic", "btk")
    return panels
