"""Small closed parts: mirrors, door handles, rails, beams."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from recast.synthetic.surface import Surface
from recast.synthetic.vehicles.finishes import CHROME, TRIM
from recast.synthetic.vehicles.loft import half_box
from recast.synthetic.vehicles.solid import Finish, Solid

Array = NDArray[np.float64]


def pebble(
    centre: tuple[float, float, float],
    size: tuple[float, float, float],
    finish: Finish,
    roundness: float = 2.5,
    cells: tuple[int, int] = (8, 12),
) -> Solid:
    """A closed superellipsoid: 2 is an ellipsoid, large values a box with rounded edges.

    Args:
        centre, size: metres.
        finish: all over.
        roundness: the exponent.
        cells: from pole to pole (along z) and around.
    """
    rows, columns = cells
    polar = np.linspace(0, np.pi, rows + 1)[1:-1]
    around = (np.arange(columns) + 0.5) * 2 * np.pi / columns
    ball = np.stack(
        [
            np.sin(polar)[:, None] * np.cos(around),
            np.sin(polar)[:, None] * np.sin(around),
            np.broadcast_to(np.cos(polar)[:, None], (rows - 1, columns)),
        ],
        axis=-1,
    ).reshape(-1, 3)
    ball = np.concatenate([ball, [[0, 0, 1.0], [0, 0, -1.0]]])
    norm = (np.abs(ball) ** roundness).sum(axis=1) ** (1 / roundness)
    points = np.array(centre) + ball / norm[:, None] * np.array(size) / 2
    index = np.arange((rows - 1) * columns).reshape(rows - 1, columns)
    after = np.roll(index, -1, axis=1)
    a, b, c, d = index[:-1], after[:-1], after[1:], index[1:]
    sides = np.concatenate([np.stack([a, c, b], -1), np.stack([a, d, c], -1)]).reshape(-1, 3)
    top, low = len(ball) - 2, len(ball) - 1
    lid = np.stack([np.full(columns, top), index[0], after[0]], axis=1)
    base = np.stack([np.full(columns, low), after[-1], index[-1]], axis=1)
    faces = np.concatenate([sides, lid, base])
    return Solid.of(points, faces, finish, crease=np.deg2rad(50))


def grid_block(xs: Array, ys: Array, zs: Array, finish: Finish) -> Solid:
    """A closed box whose sides are divided at the given coordinates (increasing)."""
    points, faces = half_box((xs, ys - ys[0], zs))
    points[:, 1] += ys[0]
    # `half_box` leaves the side at the first y open.
    at = {tuple(point): k for k, point in enumerate(np.round(points, 9).tolist())}
    index = np.array([[at[tuple(np.round((x, ys[0], z), 9))] for z in zs] for x in xs])
    a, b, c, d = index[:-1, :-1], index[1:, :-1], index[1:, 1:], index[:-1, 1:]
    side = np.concatenate([np.stack([a, b, c], -1), np.stack([a, c, d], -1)]).reshape(-1, 3)
    return Solid.of(points, np.concatenate([faces, side]), finish)


def block(
    low: tuple[float, float, float], high: tuple[float, float, float], finish: Finish
) -> Solid:
    """A closed box between two corners."""
    xs, ys, zs = (np.array([low[k], high[k]]) for k in range(3))
    return grid_block(xs, ys, zs, finish)


def mirror(x: float, y: float, z: float, paint: Finish, tall: bool = False) -> list[Solid]:
    """The left mirror, its foot at (x, y, z) on the door."""
    size = (0.16, 0.18, 0.34) if tall else (0.14, 0.21, 0.15)
    centre = (x - 0.02, y + size[1] / 2 + 0.045, z + (0.08 if tall else 0.05))
    shell = pebble(centre, size, TRIM if tall else paint, 3.0, (8, 12))
    rear = centre[0] - 0.36 * size[0]
    shell.paint(lambda s: s.points[:, 0] - rear, TRIM)
    glass = np.array(size) * 0.42

    def pane(s: Solid) -> Array:
        off = np.abs(s.points - np.array(centre)) / glass
        return np.maximum(s.points[:, 0] - rear + 0.012, (np.maximum(off[:, 1], off[:, 2]) - 1) / 9)

    shell.paint(pane, CHROME)
    foot = pebble((x, y + 0.03, z), (0.07, 0.14, 0.05), TRIM, 3.0, (4, 6))
    return [shell, foot]


def handle(x: float, y: float, z: float, finish: Finish) -> Solid:
    """A door handle on the left side."""
    return pebble((x, y + 0.006, z), (0.19, 0.04, 0.03), finish, 4.0, (4, 8))


def rail(start: tuple[float, float, float], end: tuple[float, float, float]) -> list[Solid]:
    """A roof rail on two feet, left side."""
    a, b = np.array(start), np.array(end)
    middle, span = (a + b) / 2, float(np.linalg.norm(b - a))
    bar = pebble((0, 0, 0), (span, 0.035, 0.03), TRIM, 5.0, (4, 10))
    pitch = np.arctan2(b[2] - a[2], b[0] - a[0])
    cos, sin = np.cos(pitch), np.sin(pitch)
    bar.points = bar.points @ np.array([[cos, 0, sin], [0, 1, 0], [-sin, 0, cos]]) + middle
    return [bar, *(pebble((p[0], p[1], p[2] - 0.025), (0.12, 0.04, 0.07), TRIM, 4.0, (4, 8))
                   for p in (a * 0.94 + b * 0.06, b * 0.94 + a * 0.06))]  # fmt: skip


def mirrored(part: Surface) -> Surface:
    """The same part on the other side."""
    flip = np.array([1.0, -1.0, 1.0])
    return Surface(
        part.vertices * flip,
        part.faces[:, [0, 2, 1]].copy(),
        (part.normals[:, [0, 2, 1]] * flip).astype(np.float32),
        part.colours,
        part.materials,
    )


def both(side: list[tuple[str, Surface]]) -> list[tuple[str, Surface]]:
    """Parts of the left side, by name, and their mirror images."""
    return [(f"{name}-left", part) for name, part in side] + [
        (f"{name}-right", mirrored(part)) for name, part in side
    ]
