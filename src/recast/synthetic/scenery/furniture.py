"""Street furniture: benches, bins, hydrants, parking meters, bollards, lamps, overhead lines."""

from __future__ import annotations

from itertools import pairwise

import numpy as np

from recast.synthetic.scenery.primitives import (
    at,
    boxes,
    lathe,
    quads,
    require_size,
    tube,
)
from recast.synthetic.scenery.signs import text_quads
from recast.synthetic.surface import Surface, barrel, concatenate

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
