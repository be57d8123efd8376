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
    balcony,
    bays,
    chimney,
    cornice,
    course,
    flat_roof,
    gable_roof,
    hip_roof,
    mansard,
    pick,
    plain_wall,
    scaled,
    shop_front,
    window_row,
)
from recast.synthetic.surface import (
    SceneryPanels,
    Surface,
    at,
    concatenate,
    require_count,
    require_known,
    require_size,
)

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
