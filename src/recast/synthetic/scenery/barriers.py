"""What runs along a road: fences, guard rails and walls, from x = 0 to x = length."""

from __future__ import annotations

import numpy as np
from numpy.typing import ArrayLike

from recast.synthetic.scenery.arguments import require_known, require_size
from recast.synthetic.scenery.primitives import boxes, prism, quads, tube
from recast.synthetic.surface import Surface, concatenate

FENCE_STYLES = ("wood", "picket", "mesh", "iron")
WALL_STYLES = ("brick", "concrete", "stone")

STEEL = (0.62, 0.63, 0.64)
RAIL_PROFILE = np.array(
    [
        (0.0, 0.44),
        (-0.045, 0.48),
        (-0.045, 0.53),
        (0.02, 0.57),
        (0.02, 0.61),
        (-0.045, 0.65),
        (-0.045, 0.70),
        (0.0, 0.75),
    ]
)
"""(y, z) of the W-shaped beam, from below."""


def _stations(length: float, spacing: float) -> np.ndarray:
    """Equal steps of at most `spacing` from 0 to length, both ends included."""
    return np.linspace(0.0, length, max(1, int(np.ceil(length / spacing - 1e-9))) + 1)


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
    xs = _stations(length, 0.3)
    count = len(xs) - 1
    top = height + rng.normal(0, 0.012, count)
    y = np.where(np.arange(count) % 2, -0.045, -0.03)
    low = np.column_stack([xs[:-1] + 0.004, y, np.full(count, 0.06)])
    high = np.column_stack([xs[1:] - 0.004, y + 0.02, top])
    planks = boxes(low, high, tone * rng.uniform(0.75, 1.2, (count, 1)), "wood")
    posts = _posts(_stations(length, 2.4), 0.05, height + 0.08, tone * 0.8, "wood")
    return concatenate([planks, posts, _rails(length, (0.35, height - 0.35), -0.01, tone * 0.8)])


def _pickets(rng: np.random.Generator, length: float) -> Surface:
    tone = np.array([(0.72, 0.72, 0.69), (0.35, 0.27, 0.18)][int(rng.random() < 0.3)])
    height = rng.uniform(0.9, 1.1)
    xs = _stations(length, 0.22)[:-1] + 0.06
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
    posts = _posts(_stations(length, 2.2), 0.045, height - 0.05, tone, "wood")
    return concatenate([shapes, posts, _rails(length, (0.25, height - 0.3), -0.01, tone)])


def _both_sides(front: np.ndarray, back: np.ndarray, colour: np.ndarray) -> Surface:
    """Thin boards by their two large sides; `colour` (N, 3) repeats over the quads."""
    panels = np.concatenate([front, back])
    return quads(panels, np.tile(colour, (len(panels) // len(colour), 1)), "wood")


def _mesh(rng: np.random.Generator, length: float) -> Surface:
    height = rng.uniform(1.8, 2.2)
    paint, material = [(STEEL, "metal"), ((0.03, 0.10, 0.05), "plastic")][rng.integers(2)]
    posts = _stations(length, 2.5)
    bars = [tube([[x, 0, -0.2], [x, 0, height + 0.05]], 0.03, 6, paint, material) for x in posts]
    bars += [
        tube([[0, 0, z], [length, 0, z]], 0.012, 4, paint, material)
        for z in (0.08, height / 2, height)
    ]
    xs = _stations(length, 0.25)[1:-1]
    low = np.column_stack([xs - 0.006, np.full_like(xs, -0.006), np.full_like(xs, 0.08)])
    wires = boxes(low, low + np.array([0.012, 0.012, height - 0.08]), paint, material, bottom=False)
    return concatenate([*bars, wires])


def _iron(rng: np.random.Generator, length: float) -> Surface:
    height = rng.uniform(1.1, 1.4)
    paint = [(0.02, 0.022, 0.024), (0.03, 0.07, 0.05)][rng.integers(2)]
    xs = _stations(length, 0.16)
    low = np.column_stack([xs - 0.01, np.full_like(xs, -0.01), np.full_like(xs, 0.06)])
    bars = boxes(low, low + np.array([0.02, 0.02, height - 0.06]), paint, "plastic", bottom=False)
    rails = np.array([(0.0, -0.02, 0.12), (0.0, -0.02, height - 0.16)])
    posts = _posts(_stations(length, 2.5), 0.035, height + 0.1, paint, "plastic")
    return concatenate(
        [bars, boxes(rails, rails + np.array([length, 0.04, 0.04]), paint, "plastic"), posts]
    )


def guard_rail(rng: np.random.Generator, length: float) -> Surface:
    """A steel guard rail 0.75 m tall whose beam faces -y, posts every 2 m behind it.

    Args:
        rng: chooses how weathered it is.
        length: metres, 0.5 to 2000.

    Raises:
        InputError: for impossible lengths.
    """
    require_size("guard_rail", "length", length, 0.5, 2000.0)
    tone = np.array(STEEL) * rng.uniform(0.75, 1.05)
    front = np.column_stack([np.zeros(8), RAIL_PROFILE])
    ends = np.concatenate([front, front + np.array([length, 0, 0])])
    a = np.arange(7)
    outside = np.concatenate(
        [np.stack([a + 1, a, a + 8], axis=1), np.stack([a + 1, a + 8, a + 9], axis=1)]
    )
    beam = Surface.make(ends, outside, tone, "metal", 0.0)
    behind = Surface.make(
        ends + np.array([0, 0.006, 0]), outside[:, ::-1], tone * 0.8, "metal", 0.0
    )
    xs = _stations(length, 2.0)
    xs = np.clip(xs, 0.05, length - 0.05)
    low = np.column_stack([xs - 0.04, np.full_like(xs, 0.05), np.full_like(xs, -0.3)])
    posts = boxes(low, low + np.array([0.08, 0.12, 1.0]), tone * 0.85, "metal", bottom=False)
    block = np.column_stack([xs - 0.04, np.full_like(xs, 0.0), np.full_like(xs, 0.5)])
    return concatenate(
        [
            beam,
            behind,
            posts,
            boxes(block, block + np.array([0.08, 0.05, 0.2]), tone * 0.85, "metal"),
        ]
    )


def wall(rng: np.random.Generator, length: float, height: float, style: str = "brick") -> Surface:
    """A free-standing wall with coping, about 0.3 m thick, centred on y = 0.

    Args:
        rng: chooses the colour.
        length: metres, 0.5 to 1000.
        height: metres with the coping, 0.3 to 12.
        style: "brick" (piers every 3 m), "concrete" (panels) or "stone".

    Raises:
        InputError: for impossible sizes and unknown styles.
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
    coping = prism(
        [
            (-half - 0.04, height - cope),
            (half + 0.04, height - cope),
            (half + 0.04, height - 0.4 * cope),
            (0.0, height),
            (-half - 0.04, height - 0.4 * cope),
        ],
        0.0,
        length,
        colour * 0.85 if style == "brick" else colour * 1.1,
        "concrete",
    )
    along = np.array([[0, 0, 1, 0], [1, 0, 0, 0], [0, 1, 0, 0], [0, 0, 0, 1]], np.float64)
    parts = [body, coping.transformed(along)]
    xs = _stations(length, 3.0 if style == "brick" else 4.0)
    xs = np.clip(xs, 0.18, length - 0.18)
    if style == "brick":
        low = np.column_stack([xs - 0.18, np.full_like(xs, -0.17), np.full_like(xs, -0.3)])
        parts.append(
            boxes(low, low + np.array([0.36, 0.34, height + 0.28]), colour, "brick", bottom=False)
        )
    if style == "concrete":
        low = np.column_stack([xs - 0.015, np.full_like(xs, -half - 0.004), np.zeros_like(xs)])
        high = low + np.array([0.03, 2 * half + 0.008, height - cope])
        parts.append(boxes(low, high, colour * 0.45, "concrete", bottom=False))
    return concatenate(parts)
