"""Town houses wall to wall: shops below, rows of windows above, cornices and balconies."""

from __future__ import annotations

from itertools import pairwise

import numpy as np

from recast.synthetic.scenery.facades import bays, plain_wall, wall_storey, window_row
from recast.synthetic.scenery.openings import Look, Opening
from recast.synthetic.scenery.panels import Panels
from recast.synthetic.scenery.roofs import TILES, chimney, flat_roof, mansard
from recast.synthetic.scenery.trims import balcony, cornice, course, shop_front
from recast.synthetic.scenery.walls import (
    BRICKS,
    DOORS,
    FRAMES,
    PLASTERS,
    around,
    pick,
    scaled,
)
from recast.synthetic.surface import Surface, concatenate


def urban(rng: np.random.Generator, width: float, depth: float, storeys: int | None) -> Surface:
    """See `building`."""
    count = storeys or int(rng.integers(3, 6))
    brick = rng.random() < 0.45
    wall = pick(rng, BRICKS if brick else PLASTERS)
    trim = scaled(pick(rng, np.array([(0.52, 0.50, 0.45), (0.60, 0.58, 0.54)])), 1.0)
    bay = rng.uniform(2.4, 3.3)
    centres = bays(width, bay, 0.45)
    bay = (width - 0.9) / len(centres)
    shop = rng.random() < 0.7
    ground = rng.uniform(3.7, 4.5) if shop else rng.uniform(3.1, 3.6)
    upper = rng.uniform(2.9, 3.4)
    edges = [-0.3, *(ground + upper * np.arange(count))]
    windows = len(centres) * (count - 1)
    look = Look(
        wall,
        "brick" if brick else "plaster",
        frame=pick(rng, FRAMES),
        trim=trim,
        door=pick(rng, DOORS),
        reveal=rng.uniform(0.1, 0.2),
        lights=((1, 2), (2, 1), (2, 2), (2, 3))[rng.integers(4)],
        surround=float(rng.choice([0.0, 0.12, 0.18])) if windows < 30 else 0.0,
        lean=windows > 20,
    )
    front = Panels()
    _ground_floor(front, rng, width, ground, look, shop, centres)
    _upper_floors(front, rng, width, edges, bay, centres, look)
    top = edges[-1]
    if rng.random() < 0.85:
        cornice(front, width, top - 0.35, rng.uniform(0.25, 0.5), rng.uniform(0.35, 0.55), trim)
    side = Look(scaled(wall, 0.85), look.wall_material, trim=trim, frame=look.frame, lean=True)
    walls = around(
        width,
        depth,
        front,
        plain_wall(rng, depth, edges, side, 0.12),
        plain_wall(rng, width, edges, side, 0.4),
        plain_wall(rng, depth, edges, side, 0.12),
    )
    return concatenate([*walls, _roof(rng, width, depth, top, centres - width / 2, look).surface()])


def _ground_floor(
    panels: Panels,
    rng: np.random.Generator,
    width: float,
    ground: float,
    look: Look,
    shop: bool,
    centres: np.ndarray,
) -> None:
    """Shops with an entrance between them, or windows and a door in every fourth bay."""
    if not shop:
        entrance = int(rng.integers(len(centres)))
        sill = 1.0
        holes = window_row(centres, min(1.2, 0.45 * width / len(centres)), sill, ground - 0.6)
        x = centres[entrance]
        holes[entrance] = Opening(x - 0.6, x + 0.6, 0.15, min(ground - 0.5, 2.8), "door")
        wall_storey(panels, rng, width, -0.3, ground, holes, look)
        panels.box((0, -0.05, -0.3), (x - 0.8, 0, 0.55), scaled(look.trim, 0.75), "concrete", "bkr")
        panels.box(
            (x + 0.8, -0.05, -0.3), (width, 0, 0.55), scaled(look.trim, 0.75), "concrete", "bkl"
        )
        return
    holes = []
    start, end = 0.35, width - 0.35
    if width > 7.5:
        door = Opening(start + 0.15, start + 1.35, 0.1, min(ground - 0.7, 2.9), "door")
        holes.append(door)
        start = door.right + 0.35
    shops = max(1, round((end - start) / rng.uniform(5.5, 9.0)))
    edges = np.linspace(start, end + 0.4, shops + 1)
    for a, b in pairwise(edges):
        holes.append(shop_front(panels, rng, a, b - 0.4, ground - 0.3, look))
    wall_storey(panels, rng, width, -0.3, ground, holes, look)
    course(panels, width, ground, look.trim)


def _upper_floors(
    panels: Panels,
    rng: np.random.Generator,
    width: float,
    edges: list[float],
    bay: float,
    centres: np.ndarray,
    look: Look,
) -> None:
    """Rows of windows; some columns have balconies and doors to them."""
    wide = bay * rng.uniform(0.38, 0.56)
    tall = rng.uniform(1.45, 1.9)
    with_balcony = np.zeros(len(centres), bool)
    if rng.random() < 0.4:
        with_balcony[int(rng.integers(2)) :: int(rng.integers(2, 4))] = True
    courses = rng.random() < 0.5
    for k, (low, high) in enumerate(pairwise(edges[1:])):
        # Upper rooms are lower, and their windows with them.
        height = min(tall * (1 - 0.06 * k), high - low - 0.9)
        holes = window_row(centres, wide, low + 0.85, low + 0.85 + height)
        few = k < 4 and with_balcony.sum() * (len(edges) - 2) <= 6
        for j in np.flatnonzero(with_balcony & few):
            x = centres[j]
            holes[j] = Opening(x - 0.55 * wide, x + 0.55 * wide, low + 0.1, low + 0.85 + height)
            balcony(panels, x - 0.44 * bay, x + 0.44 * bay, low + 0.05, look.trim)
        wall_storey(panels, rng, width, low, high, holes, look)
        if courses and k:
            course(panels, width, low, look.trim)


def _roof(
    rng: np.random.Generator,
    width: float,
    depth: float,
    top: float,
    columns: np.ndarray,
    look: Look,
) -> Panels:
    """Flat behind a parapet, or a mansard with dormers; chimneys on the party walls."""
    panels = Panels()
    half = width / 2
    if rng.random() < 0.6 or depth < 7:
        flat_roof(
            panels,
            rng,
            width,
            depth,
            top,
            rng.uniform(0.4, 1.0),
            look.wall,
            look.wall_material,
            look.trim,
        )
        return panels
    rise = rng.uniform(2.2, 3.0)
    tiles = pick(rng, TILES)
    mansard(panels, width, depth, top, rise, tiles, scaled(look.wall, 0.85), look.wall_material)
    for x in columns[:: 1 if len(columns) < 4 else 2]:
        low, high, back = top + 0.35, top + 0.35 + 0.6 * rise, 0.3 * rise
        panels.box(
            (x - 0.65, 0.1, low), (x + 0.65, back + 0.4, high), scaled(tiles, 1.1), "tiles", "bkf"
        )
        panels.rect(x - 0.65, x + 0.65, low, high, 0.1, look.trim, "plaster")
        panels.rect(
            x - 0.45, x + 0.45, low + 0.15, high - 0.15, 0.09, (0.03, 0.035, 0.04), "window"
        )
        panels.rect(x - 0.03, x + 0.03, low + 0.15, high - 0.15, 0.08, look.frame, "plastic")
    for x in (-half + 0.5, half - 0.5):
        if rng.random() < 0.6:
            chimney(
                panels,
                x,
                rng.uniform(0.3, 0.7) * depth,
                top,
                top + rise + rng.uniform(0.8, 1.5),
                pick(rng, BRICKS),
            )
    return panels
