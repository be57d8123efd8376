"""What stands in yards and along roads out of town: containers, pallets, advertising boards."""

from __future__ import annotations

from collections.abc import Sequence
from itertools import pairwise

import numpy as np

from recast.synthetic.scenery.trees import STEEL
from recast.synthetic.surface import (
    PALETTES,
    Point,
    SceneryPanels,
    Surface,
    at,
    boxes,
    choose,
    concatenate,
    lathe,
    prism,
    quads,
    require_count,
    require_known,
    require_size,
    stations,
    tube,
)

CONTAINER_WIDTH, CONTAINER_HEIGHT = 2.44, 2.59
RIB = 0.28
"""Metres from one rib of a container's walls to the next."""

PALLET_WOOD = np.array((0.33, 0.235, 0.14))
CARTON = np.array((0.36, 0.24, 0.13))
PALLET_HEIGHT = 0.144
FRAME = (0.06, 0.065, 0.07)


def container(rng: np.random.Generator, length: float = 6.06) -> Surface:
    """A shipping container, x in [-length/2, length/2], y in [0, 2.44], doors at +x.

    Args:
        length: metres, 2.5 to 16 (6.06 and 12.19 are the usual ones).
    """
    require_size("container", "length", length, 2.5, 16.0)
    half, w, h = length / 2, CONTAINER_WIDTH, CONTAINER_HEIGHT
    paint = choose(rng, "steel_paints") * rng.uniform(0.8, 1.2)
    panels = SceneryPanels()
    frame = 0.85 * paint
    for x in (-half, half - 0.14):
        for y in (0.0, w - 0.14):
            panels.box((x, y, 0.0), (x + 0.14, y + 0.14, h), frame, "plastic", "b")
            for z in (0.0, h - 0.12):
                block = (x - 0.004, y - 0.004, z), (x + 0.15, y + 0.15, z + 0.122)
                panels.box(*block, 0.6 * paint, "plastic")
    for y in (0.02, w - 0.12):
        panels.box((-half + 0.14, y, 0.02), (half - 0.14, y + 0.1, 0.18), frame, "plastic")
        panels.box((-half + 0.14, y, h - 0.1), (half - 0.14, y + 0.1, h - 0.01), frame, "plastic")
    roof = (-half + 0.05, 0.05, h - 0.06), (half - 0.05, w - 0.05, h - 0.02)
    panels.box(*roof, paint, "corrugated", "bfklr")
    _ribs(panels, half, 0.06, paint, front=True)
    _ribs(panels, half, w - 0.06, paint, front=False)
    ends = (-half + 0.06, 0.14, 0.1), (half - 0.08, w - 0.14, h - 0.08)
    panels.box(*ends, paint, "corrugated", "btfk")
    grey, x = (0.4, 0.4, 0.4), half - 0.08
    for y in (0.35, 0.85, w - 0.89, w - 0.39):
        panels.box((x, y, 0.12), (half - 0.03, y + 0.04, h - 0.12), grey, "metal")
        panels.box((x, y - 0.04, 1.0), (half - 0.02, y + 0.22, 1.06), grey, "metal")
    joint = (half - 0.09, w / 2 - 0.02, 0.1), (half - 0.07, w / 2 + 0.02, h - 0.1)
    panels.box(*joint, 0.2 * paint, "rubber")
    _lettering(panels, rng, half, paint)
    return panels.surface()


def _ribs(panels: SceneryPanels, half: float, y: float, paint: np.ndarray, front: bool) -> None:
    """A side wall folded outwards and inwards, looking to -y or, when not front, to +y."""
    count = max(4, round((2 * half - 0.28) / RIB))
    edges = np.linspace(-half + 0.14, half - 0.14, count + 1)
    step = edges[1] - edges[0]
    inner, low, high = y + (0.045 if front else -0.045), 0.15, CONTAINER_HEIGHT - 0.08
    for start in edges[:-1]:
        xs = start + step * np.array([0.0, 0.32, 0.5, 0.82, 1.0])
        for (a, c), (b, d) in pairwise(zip(xs, (y, y, inner, inner, y), strict=True)):
            piece = [(a, c, low), (b, d, low), (b, d, high), (a, c, high)]
            panels.polygon(piece if front else piece[::-1], paint, "plastic")


def _lettering(
    panels: SceneryPanels, rng: np.random.Generator, half: float, paint: np.ndarray
) -> None:
    """An owner's name on the front as blocks, on two thirds of all."""
    if rng.random() < 0.33:
        return
    ink = (0.7, 0.7, 0.68) if paint.max() < 0.4 else (0.05, 0.06, 0.1)
    size = rng.uniform(0.5, 0.9)
    x = -half + 0.5
    for _ in range(int(rng.integers(3, 7))):
        wide = size * rng.uniform(0.45, 0.7)
        if x + wide > half - 0.4:
            break
        panels.rect(x, x + 0.3 * wide, 1.3, 1.3 + size, 0.052, ink, "plastic")
        bar = 1.3 + size * rng.choice([0.0, 0.4, 0.8])
        panels.rect(x + 0.3 * wide, x + wide, bar, bar + 0.2 * size, 0.052, ink, "plastic")
        if rng.random() < 0.5:
            panels.rect(x + 0.7 * wide, x + wide, 1.3, 1.3 + size, 0.052, ink, "plastic")
        x += wide + 0.2 * size


def pallets(rng: np.random.Generator, count: int | None = None) -> Surface:
    """A stack of wooden pallets, 1.2 m x 1.0 m about the origin; low stacks may carry goods.

    Args:
        count: pallets in the stack, 1 to 20; drawn when None.
    """
    if count is None:
        count = int(rng.integers(1, 3)) if rng.random() < 0.6 else int(rng.integers(4, 12))
    require_count("pallets", "count", count, 1, 20)
    parts = []
    for k in range(count):
        shift = rng.normal(0, 0.015, 2) if k else np.zeros(2)
        parts.append(at(_pallet(rng), shift[0], shift[1], PALLET_HEIGHT * k, rng.normal(0, 0.02)))
    if count <= 2 and rng.random() < 0.8:
        parts.append(at(_goods(rng), 0.0, 0.0, PALLET_HEIGHT * count))
    return concatenate(parts)


def _pallet(rng: np.random.Generator) -> Surface:
    """Three skids under five boards."""
    tone = PALLET_WOOD * rng.uniform(0.7, 1.2)
    low = np.array([(-0.6, y, 0.0) for y in (-0.5, -0.05, 0.4)])
    skids = boxes(low, low + np.array([1.2, 0.1, 0.12]), 0.85 * tone, "wood", bottom=False)
    low = np.array([(x, -0.5, 0.12) for x in np.linspace(-0.6, 0.42, 5)])
    tones = tone * rng.uniform(0.85, 1.15, (5, 1))
    return concatenate([skids, boxes(low, low + np.array([0.18, 1.0, 0.022]), tones, "wood")])


def _goods(rng: np.random.Generator) -> Surface:
    """Cartons, drums, or a block in foil."""
    kind = rng.choice(["cartons", "drums", "foil"])
    if kind == "drums":
        paint = choose(rng, "steel_paints")
        shape = [(0.24, 0.0), (0.24, 0.3), (0.25, 0.31), (0.24, 0.32), (0.24, 0.84)]
        drum = lathe([*shape, (0.22, 0.86), (0.0, 0.86)], 12, paint, "plastic")
        return concatenate([at(drum, x, y) for x in (-0.28, 0.28) for y in (-0.25, 0.25)])
    if kind == "foil":
        grey, top = rng.uniform(0.3, 0.6), rng.uniform(0.8, 1.3)
        return boxes((-0.56, -0.46, 0), (0.56, 0.46, top), (grey, grey, 1.03 * grey), "plastic")
    layers = int(rng.integers(2, 5))
    low = np.array(
        [(x, y, 0.3 * z) for z in range(layers) for x in (-0.58, -0.19, 0.2) for y in (-0.48, 0.01)]
    )
    low = low[: len(low) - int(rng.integers(0, 4))]
    tones = CARTON * rng.uniform(0.85, 1.15, (len(low), 1))
    return boxes(low, low + np.array([0.37, 0.47, 0.295]), tones, "matte")


def hoarding(rng: np.random.Generator, width: float = 6.0, height: float = 3.0) -> Surface:
    """An advertising board on legs, facing -y, centred at x = 0; its lower edge 2.2 to 3 m up.

    Args:
        width, height: metres of the board, 1 to 20 and 0.8 to 10.
    """
    require_size("hoarding", "width", width, 1.0, 20.0)
    require_size("hoarding", "height", height, 0.8, 10.0)
    low = rng.uniform(2.2, 3.0)
    half, top = width / 2, low + height
    panels = SceneryPanels()
    panels.box((-half, -0.1, low), (half, 0.1, top), FRAME, "plastic")
    edge = min(0.12, 0.05 * width)
    _poster(panels, rng, -half + edge, half - edge, low + edge, top - edge)
    legs = max(2, round(width / 3.5))
    for x in np.linspace(-0.7 * half, 0.7 * half, legs):
        panels.box((x - 0.1, 0.1, -0.4), (x + 0.1, 0.3, top - 0.2), (0.2, 0.21, 0.22), "metal", "b")
        a, b, z = x - 0.05, x + 0.05, low + 0.6 * height
        brace = [(a, 1.3, 0.0), (b, 1.3, 0.0), (b, 0.3, z), (a, 0.3, z)]
        panels.polygon(brace, (0.2, 0.21, 0.22), "metal")
    panels.box((-half, -0.75, low - 0.1), (half, 0.1, low - 0.05), (0.16, 0.165, 0.17), "metal")
    for x in np.linspace(-0.6 * half, 0.6 * half, legs):
        stem = (x - 0.02, -0.7, low - 0.05), (x + 0.02, -0.66, low + 0.2)
        panels.box(*stem, FRAME, "plastic", "b")
        panels.box((x - 0.15, -0.78, low + 0.2), (x + 0.15, -0.6, low + 0.28), FRAME, "plastic")
    return panels.surface()


def _poster(
    panels: SceneryPanels,
    rng: np.random.Generator,
    left: float,
    right: float,
    low: float,
    high: float,
) -> None:
    """Ground in shaded bands, a round or slanted picture on one side, lines of lettering beside."""
    posters = PALETTES["posters"].reshape(-1, 3, 3)
    ground, ink, picture = posters[rng.integers(len(posters))] * rng.uniform(0.85, 1.1)
    width, height = right - left, high - low
    edges = np.linspace(low, high, 7)
    for k, (a, b) in enumerate(pairwise(edges)):
        shade = np.clip(ground * (0.8 + 0.07 * k), 0, 0.9)
        panels.rect(left, right, a, b, -0.105, shade, "plastic")
    mirrored = rng.random() < 0.5
    radius = 0.38 * min(height, 0.55 * width)
    cx = right - 1.25 * radius if mirrored else left + 1.25 * radius
    cz = low + height * rng.uniform(0.45, 0.55)
    for k, scale in enumerate((1.0, 0.72, 0.4)):
        sides = 18 if rng.random() < 0.7 else 4
        angle = 2 * np.pi * np.arange(sides) / sides + (0.3 if sides == 4 else 0)
        x, z = cx + scale * radius * np.cos(angle), cz + scale * radius * np.sin(angle)
        colour = (picture, ink, 0.6 * picture)[k]
        y = np.full(sides, -0.11 - 0.005 * k)
        panels.polygon(np.column_stack([x, y, z]).tolist(), colour, "plastic")
    start = left + 0.08 * width if mirrored else cx + 1.4 * radius
    end = cx - 1.4 * radius if mirrored else right - 0.08 * width
    line = high - 0.2 * height
    for k in range(3):
        size = (0.2, 0.09, 0.09)[k] * height
        pen, stop = start, start + (end - start) * rng.uniform(0.65, 1.0)
        while pen < stop - 0.3 * size:
            wide = size * rng.uniform(0.35, 0.75)
            panels.rect(pen, min(pen + wide, end), line - size, line, -0.11, ink, "plastic")
            pen += wide + 0.18 * size
        line -= size + 0.08 * height


WALL_STYLES = ("brick", "concrete", "stone")
RAIL_PROFILE = np.column_stack(
    [
        (0.0, -0.045, -0.045, 0.02, 0.02, -0.045, -0.045, 0.0),
        (0.44, 0.48, 0.53, 0.57, 0.61, 0.65, 0.70, 0.75),
    ]
)
"""(y, z) of the W-shaped beam, from below."""
SLOPE = 1.6
"""Metres across for each metre up, of the earth beside the ramps."""
DECK_DEPTH = 1.3
SLAB = 0.3
ASPHALT = (0.06, 0.06, 0.06)
GRASS = (0.09, 0.14, 0.035)


def guard_rail(rng: np.random.Generator, length: float) -> Surface:
    """A steel guard rail 0.75 m tall whose beam faces -y, posts every 2 m behind it.

    Args:
        length: metres, 0.5 to 2000.
    """
    require_size("guard_rail", "length", length, 0.5, 2000.0)
    tone = np.array(STEEL) * rng.uniform(0.75, 1.05)
    front = np.column_stack([np.zeros(8), RAIL_PROFILE])
    far = front + np.array([length, 0, 0])
    folds = np.stack([front[1:], front[:-1], far[:-1], far[1:]], axis=1)
    beam = quads(folds, tone, "metal")
    behind = quads(folds[:, ::-1] + np.array([0, 0.006, 0]), tone * 0.8, "metal")
    xs = np.clip(stations(length, 2.0), 0.05, length - 0.05) - 0.04
    low = np.array([(x, 0.05, -0.3) for x in xs])
    posts = boxes(low, low + np.array([0.08, 0.12, 1.0]), tone * 0.85, "metal", bottom=False)
    low = np.array([(x, 0.0, 0.5) for x in xs])
    blocks = boxes(low, low + np.array([0.08, 0.05, 0.2]), tone * 0.85, "metal")
    return concatenate([beam, behind, posts, blocks])


def wall(rng: np.random.Generator, length: float, height: float, style: str = "brick") -> Surface:
    """A free-standing wall with coping, about 0.3 m thick, centred on y = 0.

    Args:
        length: metres, 0.5 to 1000.
        height: metres with the coping, 0.3 to 12.
        style: "brick" (piers every 3 m), "concrete" (panels) or "stone".
    """
    require_size("wall", "length", length, 0.5, 1000.0)
    require_size("wall", "height", height, 0.3, 12.0)
    require_known("wall", "style", style, WALL_STYLES)
    half = 0.12
    cope = min(0.1, 0.25 * height)
    tone, material = {
        "brick": ((0.36, 0.16, 0.10), "brick"),
        "concrete": ((0.42, 0.41, 0.39), "concrete"),
        "stone": ((0.38, 0.35, 0.30), "brick"),
    }[style]
    colour = np.array(tone) * rng.uniform(0.8, 1.15)
    body = boxes((0, -half, -0.3), (length, half, height - cope), colour, material, bottom=False)
    out, foot, brow = half + 0.04, height - cope, height - 0.4 * cope
    outline = [(-out, foot), (out, foot), (out, brow), (0.0, height), (-out, brow)]
    shade = colour * 0.85 if style == "brick" else colour * 1.1
    coping = prism(outline, 0.0, length, shade, "concrete")
    along = np.array([[0, 0, 1, 0], [1, 0, 0, 0], [0, 1, 0, 0], [0, 0, 0, 1]], np.float64)
    parts = [body, coping.transformed(along)]
    xs = stations(length, 3.0 if style == "brick" else 4.0)
    xs = np.clip(xs, 0.18, length - 0.18)
    if style == "brick":
        low = np.array([(x - 0.18, -0.17, -0.3) for x in xs])
        high = low + np.array([0.36, 0.34, height + 0.28])
        parts.append(boxes(low, high, colour, "brick", bottom=False))
    if style == "concrete":
        low = np.array([(x - 0.015, -half - 0.004, 0.0) for x in xs])
        high = low + np.array([0.03, 2 * half + 0.008, height - cope])
        parts.append(boxes(low, high, colour * 0.45, "concrete", bottom=False))
    return concatenate(parts)


def bridge(
    rng: np.random.Generator,
    span: float,
    width: float,
    clearance: float,
    piers: Sequence[float] = (),
    approach: float = 50.0,
) -> Surface:
    """A girder bridge whose road runs along y, over a road that runs along x.

    The abutments' faces are at y = +-span/2 and the deck lies at x in [-width/2, width/2]. Ramps of
    earth reach the ground at |y| = span/2 + approach. Nothing between the abutments is lower than
    `clearance` but the piers.

    Args:
        span: metres between the abutments, 4 to 120.
        width: metres of the deck, 3 to 60.
        clearance: metres from the ground to the girders' underside, 2 to 15.
        piers: y of rows of piers, between the abutments.
        approach: metres of the ramps, 10 to 300.
    """
    require_size("bridge", "span", span, 4.0, 120.0)
    require_size("bridge", "width", width, 3.0, 60.0)
    require_size("bridge", "clearance", clearance, 2.0, 15.0)
    require_size("bridge", "approach", approach, 10.0, 300.0)
    for y in piers:
        require_size("bridge", "piers", y, -span / 2, span / 2)
    tone = np.array([0.40, 0.39, 0.36]) * rng.uniform(0.85, 1.1)
    half, ends = width / 2, span / 2
    top = clearance + DECK_DEPTH
    parts = [_deck(half, ends, clearance, tone), _railings(rng, half, ends, top)]
    for side in (-1.0, 1.0):
        parts.append(_approach(half, ends, approach, top, tone, side))
    for y in piers:
        parts.append(_pier_row(half, y, clearance, tone))
    return concatenate(parts)


def _deck(half: float, ends: float, clearance: float, tone: np.ndarray) -> Surface:
    """Slab, edge beams, girders, and the road on top."""
    top = clearance + DECK_DEPTH
    count = max(2, round(2 * half / 2.6))
    xs = np.linspace(-half + 0.6, half - 0.6, count)
    low = np.column_stack([xs - 0.25, np.full(count, -ends), np.full(count, clearance)])
    girders = boxes(low, low + np.array([0.5, 2 * ends, DECK_DEPTH - SLAB]), tone * 0.9, "concrete")
    reach = ends + 0.6
    slab = boxes((-half, -reach, top - SLAB), (half, reach, top), tone, "concrete")
    edges = boxes(
        [(-half - 0.12, -reach, top - 0.55), (half - 0.2, -reach, top - 0.55)],
        [(-half + 0.2, reach, top + 0.25), (half + 0.12, reach, top + 0.25)],
        tone * 1.1,
        "concrete",
    )
    road = boxes((-half + 0.2, -reach, top), (half - 0.2, reach, top + 0.02), ASPHALT, "asphalt")
    return concatenate([girders, slab, edges, road])


def _railings(rng: np.random.Generator, half: float, ends: float, top: float) -> Surface:
    """A railing of posts and bars on both edges."""
    paint = [(0.45, 0.46, 0.47), (0.04, 0.11, 0.07), (0.06, 0.09, 0.16)][rng.integers(3)]
    ys = np.linspace(-ends - 0.5, ends + 0.5, max(2, int(ends / 1.0) + 1))
    parts = []
    for x in (-half - 0.02, half + 0.02):
        low = np.array([(x - 0.03, y - 0.03, top + 0.25) for y in ys])
        parts.append(boxes(low, low + np.array([0.06, 0.06, 0.85]), paint, "metal"))
        parts += [
            tube([[x, ys[0], top + z], [x, ys[-1], top + z]], 0.03, 6, paint, "metal")
            for z in (0.5, 0.8, 1.1)
        ]
    return concatenate(parts)


def _approach(
    half: float, ends: float, approach: float, top: float, tone: np.ndarray, side: float
) -> Surface:
    """Abutment with wing walls, and the ramp of earth behind it, on the side of +y or -y."""
    foot = half + SLOPE * top
    near, far = side * ends, side * (ends + approach)
    # Seen along +y for side = 1: the wall is the ramp's cross section, so the earth ends at it.
    outline = np.array(
        [(-foot, -0.4), (foot, -0.4), (foot, 0.02), (half, top), (-half, top), (-foot, 0.02)]
    )
    front = np.column_stack([outline[:, 0], np.full(6, near), outline[:, 1]])
    back = front + np.array([0, side * 0.7, 0])
    fan = np.array([(0, 1, 2), (0, 2, 5), (5, 2, 3), (5, 3, 4)])
    a = np.arange(6)
    b = (a + 1) % 6
    rim = np.concatenate([np.stack([a, a + 6, b + 6], 1), np.stack([a, b + 6, b], 1)])
    faces = np.concatenate([fan, fan[:, ::-1] + 6, rim])
    lift = np.array([0, 0, 0.12])
    back[2:] += lift
    front[2:] += lift
    faces = faces if side > 0 else faces[:, ::-1]
    wall = Surface.make(np.concatenate([front, back]), faces, tone, "concrete", 0.0)
    inner, crown = half - 0.8, top + 0.03
    green: list[list[Point]] = [
        [(-half, near, top), (half, near, top), (half, far, 0), (-half, far, 0)],
        [(-foot, near, 0.0), (-half, near, top), (-half, far, 0.0)],
        [(half, near, top), (foot, near, 0.0), (half, far, 0.0)],
    ]
    lane = [(-inner, near, crown), (inner, near, crown), (inner, far, 0.03), (-inner, far, 0.03)]
    order = 1 if side > 0 else -1
    earth = SceneryPanels()
    for points in green:
        earth.polygon(points[::order], GRASS, "grass")
    earth.polygon(lane[::order], ASPHALT, "asphalt")
    return concatenate([wall, earth.surface()])


def _pier_row(half: float, y: float, clearance: float, tone: np.ndarray) -> Surface:
    """Columns and the cross beam that the girders run into."""
    count = max(2, round(2 * half / 5))
    xs = np.linspace(-half + 1.0, half - 1.0, count)
    low = np.column_stack([xs - 0.4, np.full(count, y - 0.4), np.full(count, -0.4)])
    columns = boxes(low, low + np.array([0.8, 0.8, clearance + 0.4]), tone, "concrete")
    beam = boxes(
        (-half + 0.3, y - 0.5, clearance), (half - 0.3, y + 0.5, clearance + 0.9), tone, "concrete"
    )
    return concatenate([columns, beam])
