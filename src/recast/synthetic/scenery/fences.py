"""Fences of boards, pickets, wire mesh and iron bars, from x = 0 to x = length."""

from __future__ import annotations

import numpy as np
from numpy.typing import ArrayLike

from recast.synthetic.scenery.arguments import require_known, require_size
from recast.synthetic.scenery.primitives import boxes, quads, stations, tube
from recast.synthetic.surface import Surface, concatenate

FENCE_STYLES = ("wood", "picket", "mesh", "iron")

STEEL = (0.62, 0.63, 0.64)


def fence(rng: np.random.Generator, length: float, style: str = "wood") -> Surface:
    """A fence centred on y = 0.

    Args:
        rng: chooses height, colour and unevenness.
        length: metres, 0.5 to 500.
        style: "wood" (boards, 1.5 to 1.9 m), "picket" (1 m), "mesh" (2 m) or "iron" (1.2 m).

    Raises:
        InputError: for impossible lengths and unknown styles.
    """
    require_size("fence", "length", length, 0.5, 500.0)
    require_known("fence", "style", style, FENCE_STYLES)
    return {"wood": _boards, "picket": _pickets, "mesh": _mesh, "iron": _iron}[style](rng, length)


def _posts(xs: np.ndarray, half: float, height: float, colour: ArrayLike, material: str) -> Surface:
    low = np.column_stack([xs - half, np.full_like(xs, -half), np.full_like(xs, -0.2)])
    return boxes(
        low, low + np.array([2 * half, 2 * half, height + 0.2]), colour, material, bottom=False
    )


def _rails(length: float, heights: tuple[float, ...], y: float, colour: ArrayLike) -> Surface:
    low = np.array([(0.0, y, z) for z in heights])
    return boxes(low, low + np.array([length, 0.04, 0.08]), colour, "wood")


def _boards(rng: np.random.Generator, length: float) -> Surface:
    height = rng.uniform(1.5, 1.9)
    tone = np.array([(0.24, 0.15, 0.09), (0.30, 0.25, 0.20), (0.16, 0.09, 0.05)][rng.integers(3)])
    xs = stations(length, 0.3)
    count = len(xs) - 1
    top = height + rng.normal(0, 0.012, count)
    y = np.where(np.arange(count) % 2, -0.045, -0.03)
    low = np.column_stack([xs[:-1] + 0.004, y, np.full(count, 0.06)])
    high = np.column_stack([xs[1:] - 0.004, y + 0.02, top])
    planks = boxes(low, high, tone * rng.uniform(0.75, 1.2, (count, 1)), "wood")
    posts = _posts(stations(length, 2.4), 0.05, height + 0.08, tone * 0.8, "wood")
    return concatenate([planks, posts, _rails(length, (0.35, height - 0.35), -0.01, tone * 0.8)])


def _pickets(rng: np.random.Generator, length: float) -> Surface:
    tone = np.array([(0.72, 0.72, 0.69), (0.35, 0.27, 0.18)][int(rng.random() < 0.3)])
    height = rng.uniform(0.9, 1.1)
    xs = stations(length, 0.22)[:-1] + 0.06
    tops = height + rng.normal(0, 0.01, len(xs))
    zero = np.full_like(xs, 0.08)
    left, right = xs, xs + 0.1
    y = np.full_like(xs, -0.03)
    front = np.stack(
        [
            np.column_stack(p)
            for p in (
                (left, y, zero),
                (right, y, zero),
                (right, y, tops - 0.07),
                (left, y, tops - 0.07),
            )
        ],
        axis=1,
    )
    tip = np.stack(
        [
            np.column_stack(p)
            for p in (
                (left, y, tops - 0.07),
                (right, y, tops - 0.07),
                (xs + 0.06, y, tops),
                (xs + 0.04, y, tops),
            )
        ],
        axis=1,
    )
    faces = np.concatenate([front, tip])
    back = faces[:, ::-1] + [0.0, 0.02, 0.0]
    colour = tone * rng.uniform(0.92, 1.05, (len(xs), 1))
    shapes = _both_sides(faces, back, colour)
    posts = _posts(stations(length, 2.2), 0.045, height - 0.05, tone, "wood")
    return concatenate([shapes, posts, _rails(length, (0.25, height - 0.3), -0.01, tone)])


def _both_sides(front: np.ndarray, back: np.ndarray, colour: np.ndarray) -> Surface:
    """Thin boards by their two large sides; `colour` (N, 3) repeats over the quads."""
    panels = np.concatenate([front, back])
    return quads(panels, np.tile(colour, (len(panels) // len(colour), 1)), "wood")


def _mesh(rng: np.random.Generator, length: float) -> Surface:
    height = rng.uniform(1.8, 2.2)
    paint, material = [(STEEL, "metal"), ((0.03, 0.10, 0.05), "plastic")][rng.integers(2)]
    posts = stations(length, 2.5)
    bars = [tube([[x, 0, -0.2], [x, 0, height + 0.05]], 0.03, 6, paint, material) for x in posts]
    bars += [
        tube([[0, 0, z], [length, 0, z]], 0.012, 4, paint, material)
        for z in (0.08, height / 2, height)
    ]
    xs = stations(length, 0.25)[1:-1]
    low = np.column_stack([xs - 0.006, np.full_like(xs, -0.006), np.full_like(xs, 0.08)])
    wires = boxes(low, low + np.array([0.012, 0.012, height - 0.08]), paint, material, bottom=False)
    return concatenate([*bars, wires])


def _iron(rng: np.random.Generator, length: float) -> Surface:
    height = rng.uniform(1.1, 1.4)
    paint = [(0.02, 0.022, 0.024), (0.03, 0.07, 0.05)][rng.integers(2)]
    xs = stations(length, 0.16)
    low = np.column_stack([xs - 0.01, np.full_like(xs, -0.01), np.full_like(xs, 0.06)])
    bars = boxes(low, low + np.array([0.02, 0.02, height - 0.06]), paint, "plastic", bottom=False)
    rails = np.array([(0.0, -0.02, 0.12), (0.0, -0.02, height - 0.16)])
    posts = _posts(stations(length, 2.5), 0.035, height + 0.1, paint, "plastic")
    return concatenate(
        [bars, boxes(rails, rails + np.array([length, 0.04, 0.04]), paint, "plastic"), posts]
    )
