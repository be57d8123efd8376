"""Road signs on posts, the letters on them, and traffic signals."""

from __future__ import annotations

from itertools import pairwise

import numpy as np
from numpy.typing import ArrayLike

from recast.arrays import Array
from recast.synthetic.scenery.primitives import (
    FACING_MINUS_X,
    at,
    boxes,
    lathe,
    quads,
    require_count,
    require_known,
    require_size,
    tube,
)
from recast.synthetic.surface import Surface, concatenate

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
