"""Roofs over a rectangle x in [-width/2, width/2], y in [0, depth], and trims of facades."""

from __future__ import annotations

from itertools import pairwise

import numpy as np

from recast.synthetic.scenery.facades import Colour, Facade, Opening
from recast.synthetic.scenery.primitives import PALETTES, SceneryPanels, choose

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
    for at in (x - 0.2, x + 0.2):
        pot = (at - 0.1, y - 0.1, high), (at + 0.1, y + 0.1, high + 0.35)
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
