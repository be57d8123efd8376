"""Fences of boards, pickets, wire mesh and iron bars, and hedges and bushes."""

from __future__ import annotations

import numpy as np
from numpy.typing import ArrayLike

from recast.synthetic.scenery.primitives import (
    boxes,
    choose,
    quads,
    require_known,
    require_size,
    stations,
    tube,
)
from recast.synthetic.scenery.trees import CORE_SHADE, cores, directions, sprays
from recast.synthetic.surface import Surface, concatenate, sheet

FENCE_STYLES = ("wood", "picket", "mesh", "iron")

STEEL = (0.62, 0.63, 0.64)


def fence(rng: np.random.Generator, length: float, style: str = "wood") -> Surface:
    """A fence centred on y = 0.

    Args:
        length: metres, 0.5 to 500.
        style: "wood" (boards, 1.5 to 1.9 m), "picket" (1 m), "mesh" (2 m) or "iron" (1.2 m).
    """
    require_size("fence", "length", length, 0.5, 500.0)
    require_known("fence", "style", style, FENCE_STYLES)
    return {"wood": _boards, "picket": _pickets, "mesh": _mesh, "iron": _iron}[style](rng, length)


def _posts(xs: np.ndarray, half: float, height: float, colour: ArrayLike, material: str) -> Surface:
    low = np.array([(x - half, -half, -0.2) for x in xs])
    size = np.array([2 * half, 2 * half, height + 0.2])
    return boxes(low, low + size, colour, material, bottom=False)


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
    low, y, right, neck = np.full_like(xs, 0.08), np.full_like(xs, -0.03), xs + 0.1, tops - 0.07
    board = [(xs, y, low), (right, y, low), (right, y, neck), (xs, y, neck)]
    tip = [(xs, y, neck), (right, y, neck), (xs + 0.06, y, tops), (xs + 0.04, y, tops)]
    front = np.concatenate([np.moveaxis(np.array(corners), 2, 0) for corners in (board, tip)])
    back = front[:, ::-1] + [0.0, 0.02, 0.0]
    colour = tone * rng.uniform(0.92, 1.05, (len(xs), 1))
    shapes = quads(np.concatenate([front, back]), np.tile(colour, (4, 1)), "wood")
    posts = _posts(stations(length, 2.2), 0.045, height - 0.05, tone, "wood")
    return concatenate([shapes, posts, _rails(length, (0.25, height - 0.3), -0.01, tone)])


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


def bush(rng: np.random.Generator, height: float = 1.0) -> Surface:
    """A bush at the origin, within 0.9 * height of it sideways; one in five is in flower.

    Args:
        height: metres, 0.2 to 4.
    """
    require_size("bush", "height", height, 0.2, 4.0)
    green = choose(rng, "greens") * rng.uniform(0.85, 1.2)
    blossom = choose(rng, "blossoms") if rng.random() < 0.2 else None
    count = int(rng.integers(3, 6))
    angle = 2 * np.pi * np.arange(count) / count + rng.uniform(0, 6.3)
    away = height * rng.uniform(0.18, 0.34, count)
    across = height * rng.uniform(0.3, 0.42, count)
    up = height * rng.uniform(0.30, 0.44, count)
    up[0] = 0.46 * height
    centres = np.column_stack([away * np.cos(angle), away * np.sin(angle), up])
    radii = np.column_stack([across, across, 0.98 * up])
    skins = []
    for centre, radius in zip(centres, radii, strict=True):
        out = directions(rng, 130)
        points = centre + out * radius * rng.uniform(0.8, 1.08, (130, 1))
        depth = np.linalg.norm((points - centres[:, None]) / radii[:, None], axis=2).min(axis=0)
        seen = (points[:, 2] > 0.08 * height) & (depth > 0.75)
        colour = np.tile(green, (len(points), 1))
        if blossom is not None:
            colour[rng.random(len(points)) < 0.25] = blossom
        skins.append(sprays(rng, points[seen], out[seen], 0.19 * height, colour[seen], 0.6))
    body = cores(rng, centres, 0.78 * radii, green, 1)
    return _above_ground(concatenate([body, *skins]))


def hedge(
    rng: np.random.Generator, length: float, height: float = 1.4, width: float = 0.8
) -> Surface:
    """A clipped hedge from x = 0 to x = length, centred on y = 0; about 110 triangles a metre.

    Args:
        length, height, width: metres, 0.5 to 500, 0.3 to 4 and 0.2 to 3.
    """
    require_size("hedge", "length", length, 0.5, 500.0)
    require_size("hedge", "height", height, 0.3, 4.0)
    require_size("hedge", "width", width, 0.2, 3.0)
    green = choose(rng, "greens") * rng.uniform(0.8, 1.1)
    parts = [part(rng, length, height, width, green) for part in (_body, _skin)]
    return _above_ground(concatenate(parts))


def _body(
    rng: np.random.Generator, length: float, height: float, width: float, green: np.ndarray
) -> Surface:
    """A long uneven body with rounded shoulders, closed at both ends."""
    y = 0.92 * width / 2 * np.array([-1.0, -1.0, -0.8, 0.0, 0.8, 1.0, 1.0])
    z = height * np.array([0.0, 0.55, 0.93, 0.97, 0.93, 0.55, 0.0])
    steps = max(2, round(length / 0.7))
    xs = np.linspace(0.02, length - 0.02, steps + 1)[:, None]
    rings = np.stack(np.broadcast_arrays(xs, y, z), axis=-1)
    rings = rings + rng.normal(0, 0.02, rings.shape) * [0.5, 1, 1]
    sides = sheet(np.arange(7 * (steps + 1)).reshape(-1, 7))[:, ::-1]
    fan = np.array([(0, k, k + 1) for k in range(1, 6)])
    joined = np.concatenate([sides, fan[:, ::-1], fan + 7 * steps])
    shade = CORE_SHADE * rng.uniform(0.9, 1.1, (len(joined), 1))
    return Surface.make(rings.reshape(-1, 3), joined, green * shade, "foliage")


def _skin(
    rng: np.random.Generator, length: float, height: float, width: float, green: np.ndarray
) -> Surface:
    """Sprays on both sides and the top, 44 a metre, and on the ends."""
    half = width / 2
    count = max(30, round(44 * length))
    x = rng.uniform(0.03, length - 0.03, count)
    girth = 2 * height + width
    s = rng.uniform(0, girth, count)
    left, top = s < height, (s >= height) & (s < height + width)
    y = np.where(left, -half, np.where(top, s - height - half, half))
    z = np.where(left, s, np.where(top, height, girth - s))
    out = np.column_stack([np.zeros(count), np.where(left, -1.0, np.where(top, 0, 1)), 1.0 * top])
    cap = rng.random(count) < min(0.5, 1.2 * width / (length + width))
    x = np.where(cap, np.where(rng.random(count) < 0.5, 0.0, length), x)
    y = np.where(cap, rng.uniform(-half, half, count), y)
    z = np.where(cap, rng.uniform(0, height, count), z)
    out[cap] = np.column_stack([np.where(x[cap] > 0, 1.0, -1.0), np.zeros((cap.sum(), 2))])
    points = np.column_stack([x, y, z]) * [1, 1.0, 0.99] + rng.normal(0, 0.015, (count, 3))
    light = 0.75 + 0.35 * points[:, 2:] / height
    return sprays(rng, points, out, 0.26, green * light, 0.45)


def _above_ground(surface: Surface) -> Surface:
    """With what hangs below the ground pushed up to it."""
    surface.vertices[:, 2] = np.maximum(surface.vertices[:, 2], 0.0)
    return surface
