"""Detached houses with pitched roofs, porches and garages."""

from __future__ import annotations

from itertools import pairwise

import numpy as np

from recast.synthetic.scenery.facades import bays, plain_wall, wall_storey, window_row
from recast.synthetic.scenery.openings import Look, Opening
from recast.synthetic.scenery.panels import Panels
from recast.synthetic.scenery.primitives import at
from recast.synthetic.scenery.roofs import TILES, chimney, gable_roof, hip_roof
from recast.synthetic.scenery.walls import (
    BOARDS,
    BRICKS,
    DOORS,
    FRAMES,
    PLASTERS,
    around,
    pick,
    scaled,
)
from recast.synthetic.surface import Surface, concatenate

STOREY = 2.7


def suburban(rng: np.random.Generator, width: float, depth: float, storeys: int | None) -> Surface:
    """See `building`."""
    count = storeys or int(rng.choice([1, 2, 2, 2]))
    palette, material = [(BRICKS, "brick"), (PLASTERS, "plaster"), (BOARDS, "wood")][
        rng.choice(3, p=[0.4, 0.4, 0.2])
    ]
    wall = pick(rng, palette)
    look = Look(
        wall,
        material,
        frame=pick(rng, FRAMES),
        trim=(0.55, 0.54, 0.51),
        door=pick(rng, DOORS),
        reveal=0.1,
        lights=((2, 1), (2, 2), (3, 1))[rng.integers(3)],
        surround=float(rng.choice([0.0, 0.1])),
        blinds=0.5,
    )
    edges = [-0.3, *(0.15 + STOREY * np.arange(1, count + 1))]
    front = Panels()
    door = _front(front, rng, width, edges, look)
    side = Look(wall, material, frame=look.frame, trim=look.trim, lean=True)
    walls = around(
        width,
        depth,
        front,
        plain_wall(rng, depth, edges, side, 0.5),
        plain_wall(rng, width, edges, side, 0.7),
        plain_wall(rng, depth, edges, side, 0.5),
    )
    top = float(edges[-1])
    return concatenate(
        [*walls, _roof(rng, width, depth, top, look), _porch(rng, door - width / 2, look).surface()]
    )


def _front(
    panels: Panels, rng: np.random.Generator, width: float, edges: list[float], look: Look
) -> float:
    """The street side: a garage when there is room, a door, windows; returns the door's x."""
    holes = []
    start = 0.4
    if width > 9.5 and rng.random() < 0.65:
        wide = 2.6 if width < 13 else 4.8
        gate = Look(look.wall, look.wall_material, door=pick(rng, FRAMES), reveal=0.2)
        hole = Opening(0.5, 0.5 + wide, 0.0, 2.25, "none")
        panels.rect(hole.left, hole.right, 0.0, 2.25, 0.18, gate.door, "corrugated")
        for z in (0.56, 1.12, 1.68):
            panels.rect(hole.left, hole.right, z, z + 0.02, 0.17, scaled(gate.door, 0.4), "matte")
        panels.box(
            (hole.left - 0.1, -0.04, 2.25), (hole.right + 0.1, 0.0, 2.4), look.trim, "wood", "k"
        )
        holes.append(hole)
        start = hole.right + 0.5
    door = start + rng.uniform(0.7, 0.9)
    holes.append(Opening(door - 0.5, door + 0.5, 0.15, 2.3, "door"))
    rest = width - (door + 0.8)
    ground = bays(rest, rng.uniform(2.6, 3.4), 0.3) + door + 0.8 if rest > 1.8 else np.zeros(0)
    wide = min(rng.uniform(1.3, 2.1), 0.75 * rest / max(1, len(ground)))
    holes += window_row(ground, wide, 0.95, 2.3)
    wall_storey(panels, rng, width, edges[0], edges[1], holes, look)
    centres = bays(width, rng.uniform(2.7, 3.6), 0.4)
    for low, high in pairwise(edges[1:]):
        upper = window_row(centres, rng.uniform(1.1, 1.5), low + 0.95, low + 2.2)
        wall_storey(panels, rng, width, low, high, upper, look)
        if rng.random() < 0.4:
            _shutters(panels, upper, look)
    return float(door)


def _shutters(panels: Panels, windows: list[Opening], look: Look) -> None:
    """Wooden leaves folded back on both sides of windows."""
    for w in windows:
        for a in (w.left - 0.55, w.right + 0.1):
            panels.box((a, -0.05, w.low), (a + 0.45, 0, w.high), look.door, "wood", "k")


def _porch(rng: np.random.Generator, x: float, look: Look) -> Panels:
    """A roof over the door on two posts, or a plain slab."""
    panels = Panels()
    tiles = pick(rng, TILES)
    wide, out = 1.1, 1.3
    if rng.random() < 0.5:
        panels.box((x - wide, -0.9, 2.45), (x + wide, 0, 2.58), look.trim, "wood", "k")
        return panels
    low, high = 2.45, 2.95
    panels.polygon(
        [(x - wide, -out, low), (x + wide, -out, low), (x + wide, 0, high), (x - wide, 0, high)],
        tiles,
        "tiles",
    )
    panels.box((x - wide, -out, low - 0.14), (x + wide, 0, low - 0.005), look.trim, "wood", "k")
    for side in (x - wide, x + wide):
        panels.polygon([(side, -out, low), (side, 0, low), (side, 0, high)], look.trim, "wood")
    for side in (x - wide + 0.1, x + wide - 0.2):
        panels.box(
            (side, -out + 0.1, -0.2), (side + 0.1, -out + 0.2, low - 0.14), look.trim, "wood", "bt"
        )
    panels.box((x - wide, -out, -0.3), (x + wide, 0, 0.12), (0.4, 0.39, 0.37), "concrete", "bk")
    return panels


def _roof(rng: np.random.Generator, width: float, depth: float, top: float, look: Look) -> Surface:
    """Gable to the sides, gable to the street, or hipped; most have a chimney."""
    tiles = pick(rng, TILES)
    steep = rng.uniform(0.55, 0.95)
    panels, extra = Panels(), Panels()
    form = rng.choice(["gable", "front", "hip"], p=[0.45, 0.25, 0.3])
    if form == "front" and width < 1.4 * depth:
        rise = steep * width / 2
        gable_roof(
            panels, depth, width, top, rise, 0.45, 0.35, tiles, look.wall, look.wall_material
        )
        x = 0.0
        if rise > 2.2:
            extra.rect(-0.5, 0.5, top + 0.4, top + 1.4, -0.02, (0.03, 0.035, 0.04), "window")
            extra.box((-0.6, -0.05, top + 0.3), (0.6, 0, top + 0.4), look.trim, "wood", "k")
        roof = at(panels.surface(), width / 2, depth / 2, 0.0, np.pi / 2)
    else:
        rise = steep * min(width, depth) / 2
        x = rng.choice([-0.3, 0.3]) * width
        if form == "hip":
            hip_roof(panels, width, depth, top, rise, 0.5, tiles)
        else:
            rise = steep * depth / 2
            gable_roof(
                panels, width, depth, top, rise, 0.45, 0.3, tiles, look.wall, look.wall_material
            )
        roof = panels.surface()
    if rng.random() < 0.7:
        chimney(extra, x, 0.62 * depth, top + 0.2 * rise, top + rise + 0.9, pick(rng, BRICKS))
    return concatenate([roof, extra.surface()])
