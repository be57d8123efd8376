"""Roofs over a rectangle x in [-width/2, width/2], y in [0, depth]."""

from __future__ import annotations

import numpy as np

from recast.synthetic.scenery.openings import Colour
from recast.synthetic.scenery.panels import Panels

FELT: Colour = (0.10, 0.10, 0.105)
TILES = np.array(
    [
        (0.23, 0.085, 0.05),
        (0.19, 0.085, 0.06),
        (0.075, 0.08, 0.09),
        (0.12, 0.10, 0.09),
        (0.24, 0.11, 0.07),
        (0.10, 0.11, 0.12),
        (0.15, 0.125, 0.11),
    ]
)


def flat_roof(
    panels: Panels,
    rng: np.random.Generator,
    width: float,
    depth: float,
    top: float,
    parapet: float,
    wall: Colour,
    material: str,
    coping: Colour,
) -> None:
    """A flat roof at `top` behind a parapet, with a stair head and ventilation boxes."""
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
        panels.box((x0, y0, top), (x1, y1, rim - 0.08), wall, material, "bt")
        panels.box(
            (x0 - 0.04, y0 - 0.04, rim - 0.08), (x1 + 0.04, y1 + 0.04, rim), coping, "concrete"
        )
    if width > 7 and depth > 7:
        for _ in range(int(rng.integers(1, 4))):
            w, d, h = (
                rng.uniform(0.8, min(4.0, width / 3)),
                rng.uniform(0.8, 3.0),
                rng.uniform(0.7, 2.4),
            )
            x = rng.uniform(-half + 1, half - 1 - w)
            y = rng.uniform(0.3 * depth, depth - 1 - d)
            grey = rng.uniform(0.2, 0.5)
            panels.box((x, y, top), (x + w, y + d, top + h), (grey,) * 3, "corrugated", "b")


def gable_roof(
    panels: Panels,
    width: float,
    depth: float,
    low: float,
    rise: float,
    eaves: float,
    verge: float,
    colour: Colour,
    wall: Colour,
    wall_material: str,
    material: str = "tiles",
) -> None:
    """A ridge along x over the middle, gable walls at the sides, slopes to the front and back.

    Args:
        panels: drawn on.
        width, depth: metres of the walls.
        low: height of the walls' top.
        rise: from there to the ridge.
        eaves: metres that the roof stands out in front and behind.
        verge: metres that it stands out at the sides.
        colour, material: of the roof.
        wall, wall_material: of the gables.
    """
    half, middle = width / 2, depth / 2
    slope = rise / middle
    ridge, foot, thick = low + rise, low - eaves * slope, 0.16
    for x, outward in ((-half, -1), (half, 1)):
        gable = [(x, 0.0, low), (x, middle, ridge), (x, depth, low)]
        panels.polygon(gable if outward < 0 else gable[::-1], wall, wall_material)
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


def hip_roof(
    panels: Panels,
    width: float,
    depth: float,
    low: float,
    rise: float,
    eaves: float,
    colour: Colour,
) -> None:
    """Slopes on all four sides; a pyramid over a square."""
    half = width / 2 + eaves
    y0, y1 = -eaves, depth + eaves
    run = min(width, depth) / 2 + eaves
    foot = low - 0.05
    if width >= depth:
        ends = [(-half + run, depth / 2), (half - run, depth / 2)]
    else:
        ends = [(0.0, y0 + run), (0.0, y1 - run)]
    e0, e1 = [(x, y, low + rise) for x, y in ends]
    corner = [(-half, y0, foot), (half, y0, foot), (half, y1, foot), (-half, y1, foot)]
    if width >= depth:
        slopes = [
            [corner[0], corner[1], e1, e0],
            [corner[1], corner[2], e1],
            [corner[2], corner[3], e0, e1],
            [corner[3], corner[0], e0],
        ]
    else:
        slopes = [
            [corner[0], corner[1], e0],
            [corner[1], corner[2], e1, e0],
            [corner[2], corner[3], e1],
            [corner[3], corner[0], e0, e1],
        ]
    for slope in slopes:
        distinct = [p for k, p in enumerate(slope) if not np.allclose(p, slope[k - 1])]
        panels.polygon(distinct, colour, "tiles")
    panels.box((-half, y0, foot - 0.18), (half, y1, foot), (0.45, 0.44, 0.42), "wood", "t")


def mansard(
    panels: Panels,
    width: float,
    depth: float,
    low: float,
    rise: float,
    colour: Colour,
    wall: Colour,
    wall_material: str,
) -> None:
    """A steep tiled front and back up to a flat top, between party walls."""
    half, back = width / 2, 0.35 * rise
    top = low + rise
    panels.polygon(
        [(-half, 0, low), (half, 0, low), (half, back, top), (-half, back, top)], colour, "tiles"
    )
    panels.polygon(
        [
            (half, depth, low),
            (-half, depth, low),
            (-half, depth - back, top),
            (half, depth - back, top),
        ],
        colour,
        "tiles",
    )
    panels.polygon(
        [
            (-half, back, top),
            (half, back, top),
            (half, depth - back, top),
            (-half, depth - back, top),
        ],
        FELT,
        "concrete",
    )
    for x, order in ((-half, -1), (half, 1)):
        side = [(x, 0, low), (x, depth, low), (x, depth - back, top), (x, back, top)]
        panels.polygon(side[::order], wall, wall_material)


def chimney(panels: Panels, x: float, y: float, low: float, high: float, colour: Colour) -> None:
    """A brick stack with two pots."""
    panels.box((x - 0.4, y - 0.25, low), (x + 0.4, y + 0.25, high), colour, "brick", "b")
    panels.box(
        (x - 0.46, y - 0.31, high - 0.15),
        (x + 0.46, y + 0.31, high),
        0.8 * np.asarray(colour),
        "concrete",
    )
    for offset in (-0.2, 0.2):
        panels.box(
            (x + offset - 0.1, y - 0.1, high),
            (x + offset + 0.1, y + 0.1, high + 0.35),
            (0.3, 0.12, 0.07),
            "matte",
            "b",
        )
