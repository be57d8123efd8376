"""Buildings of four styles: town houses wall to wall, detached houses, and workplaces."""

from __future__ import annotations

from itertools import pairwise

import numpy as np

from recast.synthetic.scenery.facades import (
    Facade,
    FacadeLook,
    Opening,
    around,
    bays,
    pick,
    plain_wall,
    scaled,
    window_row,
)
from recast.synthetic.scenery.primitives import (
    SceneryPanels,
    at,
    require_count,
    require_known,
    require_size,
)
from recast.synthetic.scenery.roofs import (
    balcony,
    chimney,
    cornice,
    course,
    flat_roof,
    gable_roof,
    hip_roof,
    mansard,
    shop_front,
)
from recast.synthetic.scenery.workplaces import industrial, office
from recast.synthetic.surface import Surface, concatenate

STOREY = 2.7


def urban(rng: np.random.Generator, width: float, depth: float, storeys: int | None) -> Surface:
    """See `building`."""
    count = storeys or int(rng.integers(3, 6))
    brick = rng.random() < 0.45
    wall = pick(rng, "bricks" if brick else "plasters")
    trim = scaled(pick(rng, "trims"), 1.0)
    bay = rng.uniform(2.4, 3.3)
    centres = bays(width, bay, 0.45)
    bay = (width - 0.9) / len(centres)
    shop = rng.random() < 0.7
    ground = rng.uniform(3.7, 4.5) if shop else rng.uniform(3.1, 3.6)
    upper = rng.uniform(2.9, 3.4)
    edges = [-0.3, *(ground + upper * np.arange(count))]
    windows = len(centres) * (count - 1)
    look = FacadeLook(
        wall,
        "brick" if brick else "plaster",
        frame=pick(rng, "frames"),
        trim=trim,
        door=pick(rng, "doors"),
        reveal=rng.uniform(0.1, 0.2),
        lights=((1, 2), (2, 1), (2, 2), (2, 3))[rng.integers(4)],
        surround=float(rng.choice([0.0, 0.12, 0.18])) if windows < 30 else 0.0,
        lean=windows > 20,
    )
    front = Facade(rng, width, look)
    _ground_floor(front, ground, shop, centres)
    _upper_floors(front, edges, bay, centres)
    top = edges[-1]
    if rng.random() < 0.85:
        cornice(front, top - 0.35, rng.uniform(0.25, 0.5), rng.uniform(0.35, 0.55))
    side = FacadeLook(
        scaled(wall, 0.85), look.wall_material, trim=trim, frame=look.frame, lean=True
    )
    others = ((depth, 0.12), (width, 0.4), (depth, 0.12))
    plain = [plain_wall(rng, length, edges, side, share) for length, share in others]
    roof = _urban_roof(rng, width, depth, top, centres - width / 2, look)
    return concatenate([*around(width, depth, front, *plain), roof.surface()])


def _ground_floor(panels: Facade, ground: float, shop: bool, centres: np.ndarray) -> None:
    """Shops with an entrance between them, or windows and a door in every fourth bay."""
    rng, width, look = panels.rng, panels.width, panels.look
    if not shop:
        entrance = int(rng.integers(len(centres)))
        holes = window_row(centres, min(1.2, 0.45 * width / len(centres)), 1.0, ground - 0.6)
        x = centres[entrance]
        holes[entrance] = Opening(x - 0.6, x + 0.6, 0.15, min(ground - 0.5, 2.8), "door")
        panels.storey(-0.3, ground, holes)
        base = scaled(look.trim, 0.75)
        panels.box((0, -0.05, -0.3), (x - 0.8, 0, 0.55), base, "concrete", "bkr")
        panels.box((x + 0.8, -0.05, -0.3), (width, 0, 0.55), base, "concrete", "bkl")
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
        holes.append(shop_front(panels, a, b - 0.4, ground - 0.3))
    panels.storey(-0.3, ground, holes)
    course(panels, ground)


def _upper_floors(panels: Facade, edges: list[float], bay: float, centres: np.ndarray) -> None:
    """Rows of windows; some columns have balconies and doors to them."""
    rng = panels.rng
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
            balcony(panels, x - 0.44 * bay, x + 0.44 * bay, low + 0.05)
        panels.storey(low, high, holes)
        if courses and k:
            course(panels, low)


def _urban_roof(
    rng: np.random.Generator,
    width: float,
    depth: float,
    top: float,
    columns: np.ndarray,
    look: FacadeLook,
) -> SceneryPanels:
    """Flat behind a parapet, or a mansard with dormers; chimneys on the party walls."""
    half = width / 2
    if rng.random() < 0.6 or depth < 7:
        wall = (look.wall, look.wall_material)
        return flat_roof(rng, width, depth, top, rng.uniform(0.4, 1.0), wall, look.trim)
    rise = rng.uniform(2.2, 3.0)
    tiles = pick(rng, "tiles")
    party = (scaled(look.wall, 0.85), look.wall_material)
    panels = mansard((width, depth, rise), top, tiles, party)
    for x in columns[:: 1 if len(columns) < 4 else 2]:
        low, high, back = top + 0.35, top + 0.35 + 0.6 * rise, 0.3 * rise
        start, end, glass = (x - 0.65, 0.1, low), (x + 0.65, back + 0.4, high), (0.03, 0.035, 0.04)
        panels.box(start, end, scaled(tiles, 1.1), "tiles", "bkf")
        panels.rect(x - 0.65, x + 0.65, low, high, 0.1, look.trim, "plaster")
        panels.rect(x - 0.45, x + 0.45, low + 0.15, high - 0.15, 0.09, glass, "window")
        panels.rect(x - 0.03, x + 0.03, low + 0.15, high - 0.15, 0.08, look.frame, "plastic")
    for x in (-half + 0.5, half - 0.5):
        if rng.random() < 0.6:
            y, high = rng.uniform(0.3, 0.7) * depth, top + rise + rng.uniform(0.8, 1.5)
            chimney(panels, x, y, top, high, pick(rng, "bricks"))
    return panels


def suburban(rng: np.random.Generator, width: float, depth: float, storeys: int | None) -> Surface:
    """See `building`."""
    count = storeys or int(rng.choice([1, 2, 2, 2]))
    finishes = (("bricks", "brick"), ("plasters", "plaster"), ("boards", "wood"))
    palette, material = finishes[rng.choice(3, p=[0.4, 0.4, 0.2])]
    wall = pick(rng, palette)
    look = FacadeLook(
        wall,
        material,
        frame=pick(rng, "frames"),
        trim=(0.55, 0.54, 0.51),
        door=pick(rng, "doors"),
        reveal=0.1,
        lights=((2, 1), (2, 2), (3, 1))[rng.integers(3)],
        surround=float(rng.choice([0.0, 0.1])),
        blinds=0.5,
    )
    edges = [-0.3, *(0.15 + STOREY * np.arange(1, count + 1))]
    front = Facade(rng, width, look)
    door = _suburban_front(front, edges)
    side = FacadeLook(wall, material, frame=look.frame, trim=look.trim, lean=True)
    others = ((depth, 0.5), (width, 0.7), (depth, 0.5))
    plain = [plain_wall(rng, length, edges, side, share) for length, share in others]
    walls = around(width, depth, front, *plain)
    roof = _suburban_roof(rng, width, depth, float(edges[-1]), look)
    return concatenate([*walls, roof, _porch(rng, door - width / 2, look).surface()])


def _suburban_front(panels: Facade, edges: list[float]) -> float:
    """The street side: a garage when there is room, a door, windows; returns the door's x."""
    rng, width, look = panels.rng, panels.width, panels.look
    holes = []
    start = 0.4
    if width > 9.5 and rng.random() < 0.65:
        wide, paint = 2.6 if width < 13 else 4.8, pick(rng, "frames")
        hole = Opening(0.5, 0.5 + wide, 0.0, 2.25, "none")
        panels.rect(hole.left, hole.right, 0.0, 2.25, 0.18, paint, "corrugated")
        for z in (0.56, 1.12, 1.68):
            panels.rect(hole.left, hole.right, z, z + 0.02, 0.17, scaled(paint, 0.4), "matte")
        ends = (hole.left - 0.1, -0.04, 2.25), (hole.right + 0.1, 0.0, 2.4)
        panels.box(*ends, look.trim, "wood", "k")
        holes.append(hole)
        start = hole.right + 0.5
    door = start + rng.uniform(0.7, 0.9)
    holes.append(Opening(door - 0.5, door + 0.5, 0.15, 2.3, "door"))
    rest = width - (door + 0.8)
    ground = bays(rest, rng.uniform(2.6, 3.4), 0.3) + door + 0.8 if rest > 1.8 else np.zeros(0)
    wide = min(rng.uniform(1.3, 2.1), 0.75 * rest / max(1, len(ground)))
    holes += window_row(ground, wide, 0.95, 2.3)
    panels.storey(edges[0], edges[1], holes)
    centres = bays(width, rng.uniform(2.7, 3.6), 0.4)
    for low, high in pairwise(edges[1:]):
        upper = window_row(centres, rng.uniform(1.1, 1.5), low + 0.95, low + 2.2)
        panels.storey(low, high, upper)
        if rng.random() < 0.4:
            # Wooden shutters folded back on both sides of the windows.
            for w in upper:
                for a in (w.left - 0.55, w.right + 0.1):
                    panels.box((a, -0.05, w.low), (a + 0.45, 0, w.high), look.door, "wood", "k")
    return float(door)


def _porch(rng: np.random.Generator, x: float, look: FacadeLook) -> SceneryPanels:
    """A roof over the door on two posts, or a plain slab."""
    panels = SceneryPanels()
    tiles = pick(rng, "tiles")
    wide, out = 1.1, 1.3
    if rng.random() < 0.5:
        panels.box((x - wide, -0.9, 2.45), (x + wide, 0, 2.58), look.trim, "wood", "k")
        return panels
    low, high = 2.45, 2.95
    slope = [(x - wide, -out, low), (x + wide, -out, low), (x + wide, 0, high), (x - wide, 0, high)]
    panels.polygon(slope, tiles, "tiles")
    panels.box((x - wide, -out, low - 0.14), (x + wide, 0, low - 0.005), look.trim, "wood", "k")
    for side in (x - wide, x + wide):
        panels.polygon([(side, -out, low), (side, 0, low), (side, 0, high)], look.trim, "wood")
    for side in (x - wide + 0.1, x + wide - 0.2):
        ends = (side, -out + 0.1, -0.2), (side + 0.1, -out + 0.2, low - 0.14)
        panels.box(*ends, look.trim, "wood", "bt")
    panels.box((x - wide, -out, -0.3), (x + wide, 0, 0.12), (0.4, 0.39, 0.37), "concrete", "bk")
    return panels


def _suburban_roof(
    rng: np.random.Generator, width: float, depth: float, top: float, look: FacadeLook
) -> Surface:
    """Gable to the sides, gable to the street, or hipped; most have a chimney."""
    tiles = pick(rng, "tiles")
    steep = rng.uniform(0.55, 0.95)
    extra, wall = SceneryPanels(), (look.wall, look.wall_material)
    form = rng.choice(["gable", "front", "hip"], p=[0.45, 0.25, 0.3])
    if form == "front" and width < 1.4 * depth:
        rise = steep * width / 2
        gable = gable_roof((depth, width, rise), top, (0.45, 0.35), tiles, wall)
        x = 0.0
        if rise > 2.2:
            extra.rect(-0.5, 0.5, top + 0.4, top + 1.4, -0.02, (0.03, 0.035, 0.04), "window")
            extra.box((-0.6, -0.05, top + 0.3), (0.6, 0, top + 0.4), look.trim, "wood", "k")
        roof = at(gable.surface(), width / 2, depth / 2, 0.0, np.pi / 2)
    else:
        rise = steep * min(width, depth) / 2
        x = rng.choice([-0.3, 0.3]) * width
        if form == "hip":
            roof = hip_roof((width, depth, rise), top, 0.5, tiles).surface()
        else:
            rise = steep * depth / 2
            roof = gable_roof((width, depth, rise), top, (0.45, 0.3), tiles, wall).surface()
    if rng.random() < 0.7:
        chimney(extra, x, 0.62 * depth, top + 0.2 * rise, top + rise + 0.9, pick(rng, "bricks"))
    return concatenate([roof, extra.surface()])


BUILDING_STYLES = ("urban", "suburban", "industrial", "office")

_BUILDERS = {"urban": urban, "suburban": suburban, "industrial": industrial, "office": office}


def building(
    rng: np.random.Generator, width: float, depth: float, style: str, storeys: int | None = None
) -> Surface:
    """A building whose front stands on the plane y = 0 and looks to -y.

    Its walls take up x in [-width/2, width/2] and y in [0, depth]; cornices, balconies, awnings,
    eaves and steps stand out by 1.6 m at most.

    Args:
        width, depth: metres, 4 to 120.
        style: "urban", "suburban", "industrial" or "office".
        storeys: 1 to 20; drawn from the style's usual when None.
    """
    require_size("building", "width", width, 4.0, 120.0)
    require_size("building", "depth", depth, 4.0, 120.0)
    require_known("building", "style", style, BUILDING_STYLES)
    if storeys is not None:
        require_count("building", "storeys", storeys, 1, 20)
    return _BUILDERS[style](rng, width, depth, storeys)
