"""Road signs on posts."""

from __future__ import annotations

import numpy as np
from numpy.typing import ArrayLike, NDArray

from recast.synthetic.scenery.arguments import require_count, require_known
from recast.synthetic.scenery.glyphs import text_quads
from recast.synthetic.scenery.primitives import FACING_MINUS_X, boxes, lathe, quads
from recast.synthetic.surface import Surface, concatenate

Array = NDArray[np.float64]

SIGN_KINDS = ("stop", "yield", "speed", "warning", "direction", "parking")

WHITE = (0.75, 0.75, 0.73)
RED = (0.52, 0.018, 0.02)
YELLOW = (0.85, 0.52, 0.01)
BLUE = (0.01, 0.08, 0.42)
GREEN = (0.005, 0.17, 0.075)
BLACK = (0.012, 0.012, 0.012)
GREY = (0.3, 0.31, 0.32)
STEEL = (0.6, 0.61, 0.62)

LAYER = 0.004
"""Metres between a sign's painted layers."""


def road_sign(rng: np.random.Generator, kind: str, speed: int = 50) -> Surface:
    """A sign that faces -x, read by traffic that drives in +x; its post stands at the origin.

    Args:
        rng: chooses size and height within the usual, and what a direction board says.
        kind: "stop" (octagon), "yield" (triangle), "speed" (circle), "warning" (diamond),
            "direction" (board on two posts) or "parking" (square).
        speed: number on a "speed" sign, 1 to 199.

    Raises:
        InputError: for unknown kinds and impossible speeds.
    """
    require_known("road_sign", "kind", kind, SIGN_KINDS)
    require_count("road_sign", "speed", speed, 1, 199)
    if kind == "direction":
        return _direction_board(rng)
    size = rng.uniform(0.68, 0.82)
    centre = rng.uniform(2.25, 2.55)
    half = size / 2
    face = {
        "stop": lambda: _stop(half),
        "yield": lambda: _yield(half),
        "speed": lambda: _speed(half, speed),
        "warning": lambda: _warning(half),
        "parking": lambda: _parking(half),
    }[kind]()
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


def _stop(half: float) -> Surface:
    octagon = _polygon(8, half / np.cos(np.pi / 8), np.pi / 8)
    return concatenate(
        [
            _plate(octagon),
            _layer(octagon, 1, WHITE),
            _layer(0.92 * octagon, 2, RED),
            _text("STOP", 0.5 * half, WHITE, weight=0.15),
        ]
    )


def _yield(half: float) -> Surface:
    triangle = _polygon(3, 1.25 * half, -np.pi / 2)
    return concatenate(
        [_plate(triangle), _layer(triangle, 1, RED), _layer(0.62 * triangle, 2, WHITE)]
    )


def _speed(half: float, speed: int) -> Surface:
    disc = _polygon(28, half, 0.0)
    text = str(speed)
    height = (0.86 if len(text) < 3 else 0.6) * half
    return concatenate(
        [
            _plate(disc),
            _layer(disc, 1, RED),
            _layer(0.78 * disc, 2, WHITE),
            _text(text, height, BLACK),
        ]
    )


def _warning(half: float) -> Surface:
    diamond = _polygon(4, 1.35 * half, 0.0)
    return concatenate(
        [
            _plate(diamond),
            _layer(diamond, 1, BLACK),
            _layer(0.94 * diamond, 2, YELLOW),
            _text("!", 1.15 * half, BLACK, weight=0.2),
        ]
    )


def _parking(half: float) -> Surface:
    square = _polygon(4, 1.2 * half, np.pi / 4)
    return concatenate(
        [
            _plate(square),
            _layer(square, 1, WHITE),
            _layer(0.93 * square, 2, BLUE),
            _text("P", 1.15 * half, WHITE),
        ]
    )


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
        pieces.append(
            [(a, v - 0.12), (a + stem, v - 0.12), (a + stem, v + top[k]), (a, v + top[k])]
        )
        across = v + rng.choice([-0.12, 0.03])
        pieces.append([(a, across), (b, across), (b, across + 0.04), (a, across + 0.04)])
        if rng.random() < 0.6:
            pieces.append(
                [(b - stem, v - 0.12), (b, v - 0.12), (b, v + 0.07), (b - stem, v + 0.07)]
            )
    flat = np.asarray(pieces)
    corners = np.concatenate([flat, np.full((*flat.shape[:2], 1), 3 * LAYER)], axis=2)
    return quads(corners, WHITE, "sign")
