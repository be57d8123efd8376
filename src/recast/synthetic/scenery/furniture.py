"""Road signs on posts, the letters on them, and traffic signals."""

from __future__ import annotations

from itertools import pairwise

import numpy as np
from numpy.typing import ArrayLike

from recast.arrays import Array
from recast.synthetic.surface import (
    FACING_MINUS_X,
    Surface,
    at,
    barrel,
    boxes,
    concatenate,
    lathe,
    quads,
    require_count,
    require_known,
    require_size,
    tube,
)

SIGN_KINDS = ("stop", "yield", "speed", "warning", "direction", "parking")

WHITE = (0.75, 0.75, 0.73)
RED = (0.52, 0.018, 0.02)
YELLOW = (0.85, 0.52, 0.01)
BLUE = (0.01, 0.08, 0.42)
GREEN = (0.005, 0.17, 0.075)
BLACK = (0.012, 0.012, 0.012)
GREY = (0.3, 0.31, 0.32)
STEEL = (0.6, 0.61, 0.62)

_FACES = {
    "stop": (8, 1 / np.cos(np.pi / 8), np.pi / 8, WHITE, 0.92, RED),
    "yield": (3, 1.25, -np.pi / 2, RED, 0.62, WHITE),
    "speed": (28, 1.0, 0.0, RED, 0.78, WHITE),
    "warning": (4, 1.35, 0.0, BLACK, 0.94, YELLOW),
    "parking": (4, 1.2, np.pi / 4, WHITE, 0.93, BLUE),
}
"""Corners, radius over half the size, phase; colour of the rim; share within it and its colour."""
_LETTERS = {
    "stop": ("STOP", 0.5, WHITE, 0.15),
    "warning": ("!", 1.15, BLACK, 0.2),
    "parking": ("P", 1.15, WHITE, 0.17),
}
"""Text, height over half the size, colour, weight."""
GLYPH_WIDTH = 0.6
"""Width of a glyph's centre lines as a share of its height."""
LAYER = 0.004
"""Metres between a sign's painted layers."""
SIGNAL_STATES = ("red", "amber", "green", "off")
LIT = {"red": (1.0, 0.03, 0.02), "amber": (1.0, 0.42, 0.0), "green": (0.02, 0.9, 0.35)}
UNLIT = {"red": (0.06, 0.004, 0.004), "amber": (0.06, 0.03, 0.002), "green": (0.003, 0.05, 0.03)}
LAMP_HEIGHTS = {"red": 0.66, "amber": 0.36, "green": 0.06}
"""Metres from the foot of the housing's lowest lamp box to each lamp's box."""
HOUSING = (0.018, 0.02, 0.02)


def road_sign(rng: np.random.Generator, kind: str, speed: int = 50) -> Surface:
    """A sign that faces -x, read by traffic that drives in +x; its post stands at the origin.

    Args:
        kind: "stop" (octagon), "yield" (triangle), "speed" (circle), "warning" (diamond),
            "direction" (board on two posts) or "parking" (square).
        speed: number on a "speed" sign, 1 to 199.
    """
    require_known("road_sign", "kind", kind, SIGN_KINDS)
    require_count("road_sign", "speed", speed, 1, 199)
    if kind == "direction":
        return _direction_board(rng)
    size = rng.uniform(0.68, 0.82)
    centre = rng.uniform(2.25, 2.55)
    half = size / 2
    sides, radius, phase, rim, inset, ground = _FACES[kind]
    outline = half * _polygon(sides, radius, phase)
    parts = [_plate(outline), _layer(outline, 1, rim), _layer(inset * outline, 2, ground)]
    if kind == "speed":
        parts.append(_text(str(speed), (0.86 if speed < 100 else 0.6) * half, BLACK))
    elif kind in _LETTERS:
        text, height, ink, weight = _LETTERS[kind]
        parts.append(_text(text, height * half, ink, weight=weight))
    face = concatenate(parts)
    mount = FACING_MINUS_X.copy()
    mount[:3, 3] = (-0.05, 0.0, centre)
    top = centre + 0.75 * half
    post = lathe([(0.032, -0.3), (0.032, top), (0.0, top + 0.005)], 8, STEEL, "metal")
    return concatenate([face.transformed(mount), post])


def _polygon(sides: int, radius: float, phase: float) -> Array:
    angle = phase + 2 * np.pi * np.arange(sides) / sides
    return radius * np.column_stack([np.cos(angle), np.sin(angle)])


def _layer(outline: Array, level: int, colour: ArrayLike, material: str = "sign") -> Surface:
    """A convex painted area (K, 2) that looks to +z, `level` layers above the plate."""
    vertices = np.column_stack([outline, np.full(len(outline), level * LAYER)])
    a = np.arange(1, len(outline) - 1)
    return Surface.make(vertices, np.stack([np.zeros_like(a), a, a + 1], 1), colour, material, 0.0)


def _plate(outline: Array) -> Surface:
    """The grey back of a sign, seen from behind."""
    back = _layer(outline, 0, GREY, "metal")
    return Surface.make(back.vertices - [0, 0, 0.01], back.faces[:, ::-1], GREY, "metal", 0.0)


def _text(
    text: str,
    height: float,
    colour: ArrayLike,
    level: int = 3,
    u: float = 0.0,
    v: float = 0.0,
    weight: float = 0.17,
) -> Surface:
    flat = text_quads(text, height, weight) + np.array([u, v])
    corners = np.concatenate([flat, np.full((*flat.shape[:2], 1), level * LAYER)], axis=2)
    return quads(corners, colour, "sign")


def _direction_board(rng: np.random.Generator) -> Surface:
    """A green board on two posts: rows with an arrow, a place's name as bars, a distance."""
    rows = int(rng.integers(2, 4))
    width, row = rng.uniform(2.6, 3.4), 0.55
    height = rows * row + 0.2
    low = rng.uniform(1.9, 2.3)
    board = np.array([(-1, -1), (1, -1), (1, 1), (-1, 1)]) * [width / 2, height / 2]
    inner = np.array([(-1, -1), (1, -1), (1, 1), (-1, 1)]) * [width / 2 - 0.05, height / 2 - 0.05]
    parts = [_plate(board), _layer(board, 1, WHITE), _layer(inner, 2, GREEN)]
    for k in range(rows):
        v = height / 2 - 0.1 - row * (k + 0.5)
        left = k == rows - 1
        arrow = "<" if left else "^"
        parts.append(_text(arrow, 0.36, WHITE, u=-width / 2 + 0.35, v=v, weight=0.16))
        parts.append(_name(rng, v, -width / 2 + 0.7, width / 2 - 0.75))
        distance = str(int(rng.integers(2, 100)))
        parts.append(_text(distance, 0.3, WHITE, u=width / 2 - 0.35, v=v))
    mount = FACING_MINUS_X.copy()
    mount[:3, 3] = (-0.08, 0.0, low + height / 2)
    posts = boxes(
        [(-0.05, s * width * 0.3 - 0.05, -0.3) for s in (-1, 1)],
        [(0.05, s * width * 0.3 + 0.05, low + height) for s in (-1, 1)],
        STEEL,
        "metal",
        bottom=False,
    )
    return concatenate([concatenate(parts).transformed(mount), posts])


def _name(rng: np.random.Generator, v: float, start: float, end: float) -> Surface:
    """A word at sign distance: upright bars of the letters' widths, some with ascenders."""
    count = int(rng.integers(5, 9))
    pitch = min(0.17, (end - start) / count)
    u = start + pitch * np.arange(count)
    tall = rng.random(count) < 0.3
    tall[0] = True
    top = np.where(tall, 0.13, 0.07)
    gap = rng.uniform(0.25, 0.4, count) * pitch
    pieces = []
    for k in range(count):
        a, b = u[k], u[k] + pitch - gap[k]
        stem = 0.3 * (b - a)
        pieces.append((a, a + stem, v - 0.12, v + top[k]))
        across = v + rng.choice([-0.12, 0.03])
        pieces.append((a, b, across, across + 0.04))
        if rng.random() < 0.6:
            pieces.append((b - stem, b, v - 0.12, v + 0.07))
    left, right, low, high = np.transpose(pieces)
    z = np.full_like(left, 3 * LAYER)
    corners = [(left, low, z), (right, low, z), (right, high, z), (left, high, z)]
    return quads(np.moveaxis(np.array(corners), 2, 0), WHITE, "sign")


def traffic_signal(rng: np.random.Generator, state: str = "red", reach: float = 0.0) -> Surface:
    """A signal that faces -x, read by traffic that drives in +x.

    Args:
        state: "red", "amber", "green" or "off".
        reach: metres of a mast arm to +y, over the road for traffic on the right, with a second
            head at its end; 0 for none, else 2 to 12.
    """
    require_known("traffic_signal", "state", state, SIGNAL_STATES)
    if reach != 0.0:
        require_size("traffic_signal", "reach", reach, 2.0, 12.0)
    paint, material = [
        ((0.6, 0.61, 0.62), "metal"),
        ((0.02, 0.02, 0.022), "plastic"),
        ((0.2, 0.21, 0.2), "plastic"),
    ][rng.integers(3)]
    bordered = rng.random() < 0.5
    radius = 0.06 if reach == 0.0 else 0.11
    top = 3.6 if reach == 0.0 else 6.2
    radii = radius * np.array([2.2, 2.2, 1.25, 1.0, 0.8, 0.0])
    heights = (-0.2, 0.03, 0.05, 0.5, top, top + 0.02)
    parts = [
        lathe(np.column_stack([radii, heights]), 10, paint, material),
        at(_head(state, bordered), -0.2, 0.0, 2.45),
        boxes((-0.2, -0.03, 2.6), (0.0, 0.03, 2.66), HOUSING, "plastic"),
        boxes((-0.2, -0.03, 3.2), (0.0, 0.03, 3.26), HOUSING, "plastic"),
    ]
    if reach:
        share = np.linspace(0, 1, 6)
        arm = np.column_stack([0 * share, share * reach, top - 0.35 + 0.35 * np.sin(1.57 * share)])
        parts.append(tube(arm, np.linspace(0.085, 0.05, 6), 8, paint, material))
        parts.append(at(_head(state, bordered), -0.18, reach - 0.15, top - 0.5))
    return concatenate(parts)


def _head(state: str, bordered: bool) -> Surface:
    """Three lamps in a housing 1 m tall, facing -x, its foot at the origin."""
    parts = [boxes((-0.12, -0.16, 0.0), (0.1, 0.16, 1.0), HOUSING, "plastic")]
    if bordered:
        parts.append(boxes((-0.01, -0.27, -0.1), (0.01, 0.27, 1.1), HOUSING, "plastic"))
        edge = np.array([(-0.27, -0.1), (0.245, -0.1), (-0.27, 1.075), (-0.27, -0.1)])
        size = np.array([(0.025, 1.2), (0.025, 1.2), (0.54, 0.025), (0.54, 0.025)])
        low, high = np.insert(edge, 0, -0.013, 1), np.insert(edge + size, 0, -0.009, 1)
        parts.append(boxes(low, high, (0.6, 0.6, 0.58), "sign"))
    for name, foot in LAMP_HEIGHTS.items():
        centre = foot + 0.14
        glow = (LIT[name], "signal") if name == state else (UNLIT[name], "plastic")
        lens = lathe([(0.105, 0.0), (0.085, 0.025), (0.0, 0.04)], 14, *glow)
        parts.append(at(lens.transformed(FACING_MINUS_X), -0.121, 0.0, centre))
        parts.append(_visor(centre))
    return concatenate(parts)


def _visor(centre: float) -> Surface:
    """The hood over a lamp, open below."""
    angle = np.linspace(-0.15 * np.pi, 1.15 * np.pi, 9)
    near = np.column_stack(
        [np.full(9, -0.12), 0.125 * np.cos(angle), centre + 0.125 * np.sin(angle)]
    )
    reach = 0.2 * np.clip(0.55 + 0.45 * np.sin(angle), 0.2, 1.0)
    far = near - np.column_stack([reach, np.zeros(9), np.zeros(9)])
    hood = np.stack([near[:-1], near[1:], far[1:], far[:-1]], axis=1)
    return quads(np.concatenate([hood, hood[:, ::-1]]), HOUSING, "plastic")


def _arc(cx: float, cy: float, rx: float, ry: float, start: float, end: float) -> list[list[float]]:
    """Points on an ellipse from one angle to another, degrees counter-clockwise from +u."""
    steps = max(2, round(abs(end - start) / 30))
    angle = np.deg2rad(np.linspace(start, end, steps + 1))
    return np.column_stack([cx + rx * np.cos(angle), cy + ry * np.sin(angle)]).tolist()


_UPPER = (0.3, 0.74, 0.27, 0.26)
_LOWER = (0.3, 0.27, 0.3, 0.27)
STROKES: dict[str, list[list[list[float]]]] = {
    "0": [_arc(0.3, 0.5, 0.3, 0.5, 0, 360)],
    "1": [[[0.1, 0.78], [0.36, 1.0], [0.36, 0.0]]],
    "2": [[*_arc(0.3, 0.72, 0.3, 0.28, 170, -30), [0.0, 0.0], [0.6, 0.0]]],
    "3": [_arc(*_UPPER, 160, -90), _arc(*_LOWER, 90, -160)],
    "4": [[[0.45, 0.0], [0.45, 1.0], [0.0, 0.3], [0.62, 0.3]]],
    "5": [[[0.55, 1.0], [0.08, 1.0], [0.04, 0.52], *_arc(0.28, 0.31, 0.32, 0.31, 120, -150)]],
    "6": [[[0.5, 0.97], *_arc(0.42, 0.4, 0.42, 0.57, 110, 180)], _arc(*_LOWER, 0, 360)],
    "7": [[[0.0, 1.0], [0.6, 1.0], [0.22, 0.0]]],
    "8": [_arc(*_UPPER, 0, 360), _arc(*_LOWER, 0, 360)],
    "9": [_arc(0.3, 0.72, 0.3, 0.28, 0, 360), [[0.6, 0.72], *_arc(0.2, 0.6, 0.4, 0.58, 0, -80)]],
    "O": [_arc(0.3, 0.5, 0.32, 0.5, 0, 360)],
    "P": [[[0.03, 0.0], [0.03, 1.0], *_arc(0.3, 0.74, 0.3, 0.26, 90, -90), [0.03, 0.48]]],
    "S": [[*_arc(0.3, 0.75, 0.28, 0.25, 30, 270), *_arc(0.3, 0.25, 0.3, 0.25, 90, -150)]],
    "T": [[[0.0, 1.0], [0.6, 1.0]], [[0.3, 1.0], [0.3, 0.0]]],
    "!": [[[0.3, 1.0], [0.3, 0.35]], [[0.3, 0.1], [0.3, 0.02]]],
    "^": [[[0.3, 0.0], [0.3, 1.0]], [[0.0, 0.62], [0.3, 1.0], [0.6, 0.62]]],
    "<": [[[0.62, 0.5], [0.0, 0.5]], [[0.3, 0.85], [0.0, 0.5], [0.3, 0.15]]],
    ">": [[[0.0, 0.5], [0.62, 0.5]], [[0.3, 0.85], [0.62, 0.5], [0.3, 0.15]]],
}


def text_quads(text: str, height: float, weight: float = 0.17) -> Array:
    """Flat four-sided pieces that draw a text, centred at the origin.

    Args:
        text: text made of the characters in `STROKES`.
        height: metres.
        weight: thickness of the strokes as a share of the height.

    Returns:
        (N, 4, 2) metres, u to the reader's right, v up, counter-clockwise.
    """
    advance = GLYPH_WIDTH + 2.2 * weight
    first = -(len(text) * advance - 1.2 * weight - weight) / 2
    inner = 1.0 - weight
    pieces = []
    for k, character in enumerate(text):
        for stroke in STROKES[character]:
            points = np.asarray(stroke) * [1.0, inner] + [first + k * advance, -inner / 2]
            pieces += [_segment(a, b, weight / 2) for a, b in pairwise(points)]
    return np.stack(pieces) * height


def _segment(a: Array, b: Array, half: float) -> Array:
    """A bar from a to b, a little longer than that so that bends have no gaps."""
    along = (b - a) / np.linalg.norm(b - a)
    across = half * np.array([-along[1], along[0]])
    a, b = a - 0.45 * half * along, b + 0.45 * half * along
    return np.stack([a - across, b - across, b + across, a + across])


DARK_IRON = (0.035, 0.038, 0.04)
GALVANISED = (0.58, 0.59, 0.60)
WIRE_SAG = 0.022
"""Sag of a wire as a share of its span."""


def bench(rng: np.random.Generator) -> Surface:
    """A slatted bench facing -y, 1.5 to 2.0 m wide, centred at the origin."""
    half = rng.uniform(0.75, 1.0)
    wood = np.array([(0.30, 0.17, 0.08), (0.22, 0.13, 0.07), (0.09, 0.16, 0.08)][rng.integers(3)])
    low = np.array([(-half, y, 0.42) for y in (-0.25, -0.13, -0.01, 0.11)])
    tone = wood * rng.uniform(0.8, 1.2, (4, 1))
    seat = boxes(low, low + np.array([2 * half, 0.1, 0.035]), tone, "wood")
    low = np.array([(-half, 0.23 + 0.25 * (z - 0.55), z) for z in (0.55, 0.68, 0.81)])
    tone = wood * rng.uniform(0.8, 1.2, (3, 1))
    rest = boxes(low, low + np.array([2 * half, 0.03, 0.1]), tone, "wood")
    frame = []
    for x in (-half + 0.15, half - 0.15):
        legs = [[x, -0.22, 0.0], [x, -0.19, 0.4], [x, 0.18, 0.4], [x, 0.25, 0.6], [x, 0.33, 0.92]]
        frame.append(tube(legs, 0.028, 6, DARK_IRON, "plastic"))
        frame.append(tube([[x, 0.2, 0.0], [x, 0.15, 0.4]], 0.028, 6, DARK_IRON, "plastic"))
    return concatenate([seat, rest, *frame])


def litter_bin(rng: np.random.Generator) -> Surface:
    """A litter bin about 1 m tall, facing -y, at the origin."""
    paints = [(0.03, 0.10, 0.05), (0.04, 0.04, 0.045), (0.2, 0.21, 0.22), (0.35, 0.12, 0.03)]
    paint = paints[rng.integers(4)]
    height = rng.uniform(0.85, 1.05)
    if rng.random() < 0.5:
        body = lathe([(0.22, 0.0), (0.25, 0.05), (0.26, height - 0.3)], 14, paint, "plastic")
        lid = [(0.28, -0.14), (0.27, -0.04), (0.15, 0.02), (0.0, 0.03)]
        hood = at(lathe(lid, 14, paint, "plastic"), 0.0, 0.0, height)
        rim = lathe([(0.2, height - 0.32), (0.2, height - 0.1)], 14, (0.01,) * 3, "rubber")
        band = lathe([(0.265, height - 0.4), (0.265, height - 0.3)], 14, GALVANISED, "metal")
        return concatenate([body, hood, rim, band])
    side = 0.25
    slot = boxes((-0.17, -0.26, height - 0.26), (0.17, -0.24, height - 0.13), (0.01,) * 3, "rubber")
    label = boxes((-0.1, -0.256, 0.45), (0.1, -0.25, 0.58), (0.6, 0.6, 0.58), "plastic")
    return concatenate(
        [
            boxes((-side, -side, 0.05), (side, side, height), paint, "plastic"),
            boxes((-0.2, -0.2, 0.0), (0.2, 0.2, 0.05), DARK_IRON, "plastic", bottom=False),
            boxes((-0.28, -0.28, height), (0.28, 0.28, height + 0.05), paint, "plastic"),
            slot,
            label,
        ]
    )


def hydrant(rng: np.random.Generator) -> Surface:
    """A pillar hydrant 0.7 to 0.8 m tall with two side outlets and one to -y, at the origin."""
    paint = [(0.55, 0.03, 0.025), (0.75, 0.42, 0.02), (0.5, 0.05, 0.03)][rng.integers(3)]
    cap = paint if rng.random() < 0.5 else (0.55, 0.56, 0.57)
    top = rng.uniform(0.7, 0.8)
    foot = [(0.17, 0.0), (0.17, 0.04), (0.11, 0.05)]
    radii = (0.11, 0.15, 0.15, 0.12, 0.10, 0.05, 0.03, 0.0)
    heights = top - np.array([0.22, 0.21, 0.17, 0.16, 0.07, 0.03, 0.0, 0.0])
    profile = [*foot, *zip(radii, heights, strict=True)]
    arm_z = top - 0.33
    outlets = [
        tube([[-0.2, 0, arm_z], [0.2, 0, arm_z]], 0.055, 8, cap, "plastic"),
        tube([[0, 0, arm_z - 0.03], [0, -0.19, arm_z - 0.03]], 0.075, 10, cap, "plastic"),
    ]
    return concatenate([lathe(profile, 12, paint, "plastic"), *outlets])


def parking_meter(rng: np.random.Generator) -> Surface:
    """A parking meter facing -y: a post with a head, or a pay cabinet, at the origin."""
    if rng.random() < 0.5:
        shape = [(0.05, 1.02), (0.1, 1.06), (0.11, 1.22), (0.09, 1.33), (0.0, 1.38)]
        head = lathe(shape, 12, (0.16, 0.17, 0.19), "plastic")
        face = boxes((-0.06, -0.115, 1.14), (0.06, -0.09, 1.24), (0.04, 0.05, 0.06), "window")
        post = lathe([(0.035, 0.0), (0.035, 1.04)], 8, GALVANISED, "metal")
        return concatenate([post, head, face])
    paint = [(0.08, 0.1, 0.13), (0.05, 0.12, 0.3), (0.25, 0.26, 0.27)][rng.integers(3)]
    height = rng.uniform(1.5, 1.7)
    body = boxes((-0.16, -0.13, -height), (0.16, 0.13, 0.0), paint, "plastic", bottom=False)
    slot = boxes((-0.06, -0.145, -0.6), (0.06, -0.13, -0.46), GALVANISED, "metal")
    screen = boxes((-0.1, -0.14, -0.4), (0.1, -0.13, -0.2), (0.04, 0.06, 0.06), "window")
    neck = lathe([(0.03, 0.0), (0.03, 0.2)], 8, GALVANISED, "metal")
    disc = tube([[0, -0.03, 0.35], [0, 0.03, 0.35]], 0.2, 16, (0.02, 0.09, 0.4), "sign")
    parts = [body, screen, slot, neck, disc, _letter_p(0.35)]
    return at(concatenate(parts), 0.0, 0.0, height)


def _letter_p(z: float) -> Surface:
    """The letter on the disc of a pay cabinet."""
    flat = text_quads("P", 0.24)
    y = np.full((*flat.shape[:2], 1), -0.034)
    corners = np.concatenate([flat[..., :1], y, flat[..., 1:] + z], axis=2)
    return quads(corners, (0.75, 0.75, 0.73), "sign")


def bollard(rng: np.random.Generator) -> Surface:
    """A bollard 0.8 to 1.05 m tall with a light band, at the origin."""
    height = rng.uniform(0.8, 1.05)
    radius = rng.uniform(0.05, 0.09)
    paint = [DARK_IRON, (0.25, 0.26, 0.27), (0.03, 0.08, 0.05)][rng.integers(3)]
    radii = radius * np.array([1.4, 1.4, 1.0, 1.0, 1.2, 1.2, 0.0])
    heights = [0.0, 0.06, 0.1, height - 0.12, height - 0.1, height - 0.05, height]
    post = lathe(np.column_stack([radii, heights]), 10, paint, "plastic")
    band = [(radius * 1.03, height - 0.32), (radius * 1.03, height - 0.2)]
    return concatenate([post, lathe(band, 10, (0.7, 0.7, 0.66), "sign")])


def lamp_post(rng: np.random.Generator, height: float = 8.0, reach: float = 1.6) -> Surface:
    """A street lamp: tapered post at the origin, curved arm that reaches to -y.

    Args:
        height: metres of the lamp over the ground, 3 to 15.
        reach: metres from the post to the middle of the head, 0.3 to 4.
    """
    require_size("lamp_post", "height", height, 3.0, 15.0)
    require_size("lamp_post", "reach", reach, 0.3, 4.0)
    paint, material = [
        ((0.6, 0.62, 0.63), "metal"),
        ((0.05, 0.06, 0.055), "plastic"),
        ((0.03, 0.09, 0.06), "plastic"),
        ((0.22, 0.23, 0.24), "plastic"),
    ][rng.choice(4, p=[0.5, 0.2, 0.1, 0.2])]
    bend = min(0.9, 0.5 * reach) + rng.uniform(0.0, 0.3)
    base = rng.uniform(0.09, 0.12)
    foot = [(base * 1.5, -0.1), (base * 1.5, 0.04), (base, 0.06), (base, rng.uniform(0.8, 1.3))]
    post = lathe([*foot, (0.075, foot[-1][1] + 0.06), (0.05, height - bend)], 10, paint, material)
    angle = np.linspace(0, np.pi / 2, 5)
    y, z = -reach * (1 - np.cos(angle)), height - bend + bend * np.sin(angle)
    bow = np.column_stack([np.zeros(6), [*y, y[-1] - 0.1], [*z, z[-1]]])
    arm = tube(bow, np.linspace(0.05, 0.03, 6), 6, paint, material)
    length = rng.uniform(0.55, 0.8)
    head = _lamp_head(length, paint if rng.random() < 0.6 else (0.5, 0.52, 0.53))
    return concatenate([post, arm, at(head, 0.0, -reach - 0.05, height)])


def _lamp_head(length: float, colour: tuple[float, float, float]) -> Surface:
    """A flat luminaire along -y whose lens looks down."""
    shape = [(0.0, 0.06, 0.03), (-0.2, 0.13, 0.06), (-0.75, 0.14, 0.05), (-1.0, 0.06, 0.02)]
    corners = [
        [(-w, y, -0.04), (w, y, -0.04), (0.7 * w, y, h - 0.01), (-0.7 * w, y, h - 0.01)]
        for y, w, h in shape
    ]
    rings = np.array(corners) * [1.0, length, 1.0]
    lens = boxes((-0.1, -0.8 * length, -0.055), (0.1, -0.2 * length, -0.04), (0.7,) * 3, "plastic")
    return concatenate([Surface.make(*barrel(rings), colour, "plastic"), lens])


def pole_line(
    rng: np.random.Generator, length: float, spacing: float = 35.0, height: float = 9.0
) -> Surface:
    """Wooden poles from x = 0 to x = length with cross arms, insulators and sagging wires.

    Args:
        length: metres, 5 to 2000.
        spacing: metres between poles at most, 10 to 80.
        height: metres of the poles, 5 to 15.
    """
    require_size("pole_line", "length", length, 5.0, 2000.0)
    require_size("pole_line", "spacing", spacing, 10.0, 80.0)
    require_size("pole_line", "height", height, 5.0, 15.0)
    spans = max(1, int(np.ceil(length / spacing)))
    xs = np.linspace(0.0, length, spans + 1)
    arm_half = 0.95
    arm_y = np.array([-0.85, 0.35, 0.85])
    arm_z = height - 0.55
    shade = np.array([0.17, 0.12, 0.08]) * rng.uniform(0.75, 1.2, (len(xs), 1))
    pole = [(0.16, -0.3), (0.11, height), (0.0, height + 0.03)]
    parts = [at(lathe(pole, 8, tone, "wood"), x, 0) for x, tone in zip(xs, shade, strict=True)]
    low = np.array([(x - 0.06, -arm_half, arm_z) for x in xs])
    parts.append(boxes(low, low + np.array([0.12, 2 * arm_half, 0.1]), shade, "wood"))
    knob = lathe([(0.03, 0.0), (0.05, 0.06), (0.03, 0.14), (0.0, 0.16)], 5, (0.4,) * 3, "plastic")
    parts += [at(knob, x, y, arm_z + 0.1) for x in xs for y in arm_y]
    wires = [(y, arm_z + 0.22, 0.014) for y in arm_y] + [(0.13, height - 2.2, 0.03)]
    share = np.linspace(0, 1, 9)
    for start, end in pairwise(xs):
        sag = 4 * share * (1 - share) * (end - start) * WIRE_SAG
        for y, z, radius in wires:
            path = np.column_stack([start + share * (end - start), np.full(9, y), z - sag])
            parts.append(tube(path, radius, 3, (0.03, 0.03, 0.03), "rubber"))
    if rng.random() < 0.5:
        x = xs[int(rng.integers(len(xs)))]
        tank = [(0.0, -0.5), (0.26, -0.5), (0.26, 0.45), (0.0, 0.5)]
        parts.append(at(lathe(tank, 10, (0.35,) * 3, "metal"), x, 0.42, height - 1.9))
    return concatenate(parts)
