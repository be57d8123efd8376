"""Office blocks: bands of glass, curtain walls, or deep grids."""

from __future__ import annotations

from itertools import pairwise

import numpy as np

from recast.synthetic.scenery.facades import bays, wall_storey, window_row
from recast.synthetic.scenery.openings import Colour, Look
from recast.synthetic.scenery.panels import Panels
from recast.synthetic.scenery.roofs import flat_roof
from recast.synthetic.scenery.walls import around, pick, scaled
from recast.synthetic.surface import Surface, concatenate

CLADDINGS = np.array(
    [
        (0.48, 0.47, 0.44),
        (0.36, 0.36, 0.36),
        (0.58, 0.57, 0.54),
        (0.20, 0.21, 0.22),
        (0.42, 0.34, 0.26),
        (0.30, 0.16, 0.11),
    ]
)
TINTS = np.array(
    [(0.02, 0.035, 0.05), (0.03, 0.05, 0.05), (0.025, 0.03, 0.03), (0.04, 0.06, 0.085)]
)
PANES = 310
"""At most on the whole building; panes get wider before there are more."""


def office(rng: np.random.Generator, width: float, depth: float, storeys: int | None) -> Surface:
    """See `building`."""
    count = storeys or int(rng.integers(3, 8))
    ground, upper = rng.uniform(3.9, 4.8), rng.uniform(3.3, 3.8)
    edges = np.concatenate([[0.0], ground + upper * np.arange(count)])
    wall, tint = pick(rng, CLADDINGS), pick(rng, TINTS, 0.25)
    form = ("bands", "curtain", "grid")[rng.integers(3)]
    frame = pick(rng, np.array([(0.05, 0.052, 0.055), (0.42, 0.43, 0.44)]))
    pane = max(rng.uniform(1.4, 2.4), 2 * (width + depth) * count / PANES)
    look = Look(
        wall, "concrete", frame=frame, trim=scaled(wall, 1.15), reveal=0.3, lean=True, blinds=0.25
    )
    sides = []
    for k, length in enumerate((width, depth, width, depth)):
        panels = Panels()
        _ground(panels, rng, length, ground, look, tint, entrance=k == 0)
        for low, high in pairwise(edges[1:]):
            _storey(panels, rng, form, length, low, high, pane, look, tint, k == 0)
        if form == "curtain":
            _fins(panels, length, ground, float(edges[-1]), 2 * pane, look.frame)
        sides.append(panels)
    roof = Panels()
    flat_roof(
        roof,
        rng,
        width,
        depth,
        float(edges[-1]),
        rng.uniform(0.5, 1.1),
        look.trim,
        "concrete",
        look.frame,
    )
    return concatenate([*around(width, depth, *sides), roof.surface()])


def _ground(
    panels: Panels,
    rng: np.random.Generator,
    length: float,
    high: float,
    look: Look,
    tint: Colour,
    entrance: bool,
) -> None:
    """Tall glass between piers; the front has a canopy and doors."""
    panels.rect(0, length, -0.3, 0.25, 0.0, scaled(look.wall, 0.6), "concrete")
    panels.rect(0, length, high - 0.7, high, 0.0, look.trim, "concrete")
    panels.polygon(
        [
            (0, 0.5, high - 0.7),
            (length, 0.5, high - 0.7),
            (length, 0, high - 0.7),
            (0, 0, high - 0.7),
        ],
        look.trim,
        "concrete",
    )
    centres = bays(length, max(4.5, length / 7), 0.0)
    step = length / len(centres)
    for x in centres:
        shade = np.asarray(tint) * rng.uniform(0.6, 1.6)
        panels.rect(x - step / 2, x + step / 2, 0.25, high - 0.7, 0.4, shade, "window")
        panels.rect(x - 0.05, x + 0.05, 0.25, high - 0.7, 0.37, look.frame, "plastic")
    panels.rect(0, length, 2.5, 2.6, 0.36, look.frame, "plastic")
    for x in np.linspace(0.35, length - 0.35, len(centres) + 1):
        panels.box(
            (x - 0.35, -0.06, -0.3), (x + 0.35, 0.5, high - 0.7), look.wall, "concrete", "btk"
        )
    if entrance:
        x = centres[len(centres) // 2]
        panels.box((x - 2.2, -1.5, 2.9), (x + 2.2, 0.3, 3.15), look.frame, "metal")
        panels.box(
            (x - 1.7, -0.15, -0.3), (x + 1.7, 0.4, 0.12), (0.35, 0.34, 0.33), "concrete", "bk"
        )
        for a in (-1.0, 0.05):
            panels.rect(x + a, x + a + 0.95, 0.12, 2.45, 0.3, (0.05, 0.06, 0.065), "window")
            panels.rect(x + a + 0.85, x + a + 0.9, 0.9, 1.4, 0.26, (0.5, 0.5, 0.5), "metal")


def _storey(
    panels: Panels,
    rng: np.random.Generator,
    form: str,
    length: float,
    low: float,
    high: float,
    pane: float,
    look: Look,
    tint: Colour,
    front: bool,
) -> None:
    if form == "grid":
        centres = bays(length, max(2.6, 1.9 * pane), 0.2)
        wide = 0.6 * (length - 0.4) / len(centres)
        holes = window_row(centres, wide, low + 0.75, high - 0.45)
        if front:
            wall_storey(panels, rng, length, low, high, holes, look)
            return
        panels.rect(0, length, low, high, 0.0, look.wall, "concrete")
        for hole in holes:
            shade = np.asarray(tint) * rng.uniform(0.6, 1.5)
            panels.rect(hole.left, hole.right, hole.low, hole.high, -0.01, shade, "window")
        return
    sill, back = (low + 0.95, 0.25) if form == "bands" else (low + 0.7, 0.02)
    spandrel = look.wall if form == "bands" else scaled(tint, 1.8)
    panels.rect(0, length, low, sill, 0.0, spandrel, "concrete" if form == "bands" else "window")
    if form == "bands":
        panels.rect(0, length, high - 0.3, high, 0.0, spandrel, "concrete")
        panels.polygon(
            [(0, 0, sill), (length, 0, sill), (length, back, sill), (0, back, sill)],
            look.trim,
            "concrete",
        )
        panels.polygon(
            [
                (0, back, high - 0.3),
                (length, back, high - 0.3),
                (length, 0, high - 0.3),
                (0, 0, high - 0.3),
            ],
            look.wall,
            "concrete",
        )
    top = high - 0.3 if form == "bands" else high
    edges = np.linspace(0, length, max(2, round(length / pane)) + 1)
    for a, b in pairwise(edges):
        shade = np.asarray(tint) * rng.uniform(0.6, 1.5)
        if rng.random() < 0.16:
            shade = shade + rng.uniform(0.05, 0.2)
        panels.rect(a, b - 0.08, sill, top, back, shade, "window")
        panels.rect(b - 0.08, b, sill, top, back - 0.01, look.frame, "plastic")
    panels.rect(0, length, sill - 0.05, sill + 0.03, back - 0.02, look.frame, "plastic")


def _fins(
    panels: Panels, length: float, low: float, high: float, step: float, colour: Colour
) -> None:
    """Upright bars in front of a curtain wall."""
    for x in np.linspace(0.06, length - 0.06, max(2, round(length / step)) + 1):
        panels.box((x - 0.05, -0.15, low), (x + 0.05, 0, high), colour, "metal", "tk")
