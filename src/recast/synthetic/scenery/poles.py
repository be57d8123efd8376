"""Lamp posts and overhead lines."""

from __future__ import annotations

from itertools import pairwise

import numpy as np

from recast.synthetic.scenery.arguments import require_size
from recast.synthetic.scenery.primitives import at, boxes, lathe, tube
from recast.synthetic.surface import Surface, concatenate

WIRE_SAG = 0.022
"""Sag of a wire as a share of its span."""


def lamp_post(rng: np.random.Generator, height: float = 8.0, reach: float = 1.6) -> Surface:
    """A street lamp: tapered post at the origin, curved arm that reaches to -y.

    Args:
        rng: chooses paint, base and head.
        height: metres of the lamp over the ground, 3 to 15.
        reach: metres from the post to the middle of the head, 0.3 to 4.

    Raises:
        InputError: for impossible sizes.
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
    arm = np.stack(
        [np.zeros(5), -reach * (1 - np.cos(angle)), height - bend + bend * np.sin(angle)], axis=1
    )
    tip = arm[-1] + [0.0, -0.1, 0.0]
    head_length = rng.uniform(0.55, 0.8)
    head_colour = paint if rng.random() < 0.6 else (0.5, 0.52, 0.53)
    shell = _lamp_head(head_length, head_colour)
    return concatenate(
        [
            post,
            tube(np.vstack([arm, tip]), np.linspace(0.05, 0.03, 6), 6, paint, material),
            at(shell, 0.0, -reach - 0.05, height),
        ]
    )


def _lamp_head(length: float, colour: tuple[float, float, float]) -> Surface:
    """A flat luminaire along -y whose lens looks down."""
    shape = [(0.0, 0.06, 0.03), (-0.2, 0.13, 0.06), (-0.75, 0.14, 0.05), (-1.0, 0.06, 0.02)]
    rings = np.array(
        [
            [
                (-w, y * length, -0.04),
                (w, y * length, -0.04),
                (0.7 * w, y * length, h - 0.01),
                (-0.7 * w, y * length, h - 0.01),
            ]
            for y, w, h in shape
        ]
    )
    vertices = rings.reshape(-1, 3)
    faces = []
    for k in range(len(shape) - 1):
        for j in range(4):
            a, b = 4 * k + j, 4 * k + (j + 1) % 4
            faces += [(a, b, b + 4), (a, b + 4, a + 4)]
    last = 4 * (len(shape) - 1)
    faces += [(2, 1, 0), (3, 2, 0), (last, last + 1, last + 2), (last, last + 2, last + 3)]
    lens = boxes((-0.1, -0.8 * length, -0.055), (0.1, -0.2 * length, -0.04), (0.7,) * 3, "plastic")
    return concatenate([Surface.make(vertices, faces, colour, "plastic"), lens])


def pole_line(
    rng: np.random.Generator, length: float, spacing: float = 35.0, height: float = 9.0
) -> Surface:
    """Wooden poles from x = 0 to x = length with cross arms, insulators and sagging wires.

    Args:
        rng: chooses lean and colour of the poles.
        length: metres, 5 to 2000.
        spacing: metres between poles at most, 10 to 80.
        height: metres of the poles, 5 to 15.

    Raises:
        InputError: for impossible sizes.
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
    parts = []
    for x, colour in zip(xs, shade, strict=True):
        parts.append(
            at(lathe([(0.16, -0.3), (0.11, height), (0.0, height + 0.03)], 8, colour, "wood"), x, 0)
        )
    parts.append(
        boxes(
            np.column_stack([xs - 0.06, np.full_like(xs, -arm_half), np.full_like(xs, arm_z)]),
            np.column_stack([xs + 0.06, np.full_like(xs, arm_half), np.full_like(xs, arm_z + 0.1)]),
            shade,
            "wood",
        )
    )
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
        drum = lathe(
            [(0.0, -0.5), (0.26, -0.5), (0.26, 0.45), (0.0, 0.5)], 10, (0.35,) * 3, "metal"
        )
        parts.append(at(drum, x, 0.42, height - 1.9))
    return concatenate(parts)
