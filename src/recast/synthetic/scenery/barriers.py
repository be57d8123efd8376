"""Guard rails and free-standing walls, from x = 0 to x = length."""

from __future__ import annotations

import numpy as np

from recast.synthetic.scenery.arguments import require_known, require_size
from recast.synthetic.scenery.primitives import boxes, prism, stations
from recast.synthetic.surface import Surface, concatenate

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
    xs = stations(length, 2.0)
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
    xs = stations(length, 3.0 if style == "brick" else 4.0)
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
