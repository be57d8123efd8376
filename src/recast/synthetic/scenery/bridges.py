"""Bridges that carry another road over ours, guard rails, and free-standing walls."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from recast.synthetic.scenery.fences import STEEL
from recast.synthetic.scenery.primitives import (
    Point,
    SceneryPanels,
    boxes,
    prism,
    quads,
    require_known,
    require_size,
    stations,
    tube,
)
from recast.synthetic.surface import Surface, concatenate

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
