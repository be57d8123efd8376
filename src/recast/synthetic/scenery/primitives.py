"""Boxes, panels, prisms, lathed bodies and letters, put together within checked sizes."""

from __future__ import annotations

from collections.abc import Sequence
from itertools import pairwise

import numpy as np
from numpy.typing import ArrayLike

from recast.arrays import Array
from recast.core.errors import InputError
from recast.synthetic.surface import Surface, concatenate

BOX_FACES = np.array(
    [[0, 2, 3, 1], [4, 5, 7, 6], [0, 1, 5, 4], [2, 6, 7, 3], [0, 4, 6, 2], [1, 3, 7, 5]]
)
"""Quads over the corners numbered x + 2 y + 4 z: bottom, top, -y, +y, -x, +x."""
_BOX_CORNERS = np.array([[k & 1, k >> 1 & 1, k >> 2] for k in range(8)], np.float64)
Point = Sequence[float]
GLYPH_WIDTH = 0.6
"""Width of a glyph's centre lines as a share of its height."""


def require_size(where: str, field: str, value: float, least: float, greatest: float) -> float:
    """The value, when it is a finite number of metres in [least, greatest]; else `InputError`."""
    if not np.isfinite(value) or not least <= value <= greatest:
        advice = f"give metres from {least:g} to {greatest:g}"
        raise InputError(where, field, f"{value} is not possible", advice)
    return float(value)


def require_count(where: str, field: str, value: int, least: int, greatest: int) -> int:
    """The value, when it is a whole number in [least, greatest]; else `InputError`."""
    if not np.isfinite(value) or value != int(value) or not least <= value <= greatest:
        advice = f"give a number from {least} to {greatest}"
        raise InputError(where, field, f"{value} is not possible", advice)
    return int(value)


def require_known(where: str, field: str, value: str, known: Sequence[str]) -> str:
    """The value, when it is one of the known; else `InputError` that lists them."""
    if value not in known:
        raise InputError(where, field, f"'{value}' is unknown", f"use one of {', '.join(known)}")
    return value


def quads(corners: ArrayLike, colour: ArrayLike, material: str) -> Surface:
    """Flat four-sided panels.

    Args:
        corners: (N, 4, 3) metres, counter-clockwise seen from the side that is looked at.
        colour: (3,) or (N, 3) linear RGB.
        material: a name in `MATERIALS`.
    """
    points = np.asarray(corners, np.float64).reshape(-1, 4, 3)
    first = 4 * np.arange(len(points))[:, None]
    faces = np.concatenate([first + np.array([0, 1, 2]), first + np.array([0, 2, 3])], axis=1)
    per_quad = np.broadcast_to(np.asarray(colour, np.float32), (len(points), 3))
    return Surface.make(points.reshape(-1, 3), faces, np.repeat(per_quad, 2, axis=0), material, 0.0)


def boxes(
    lower: ArrayLike, upper: ArrayLike, colour: ArrayLike, material: str, *, bottom: bool = True
) -> Surface:
    """Boxes along the axes, 12 triangles each (10 without bottoms).

    Args:
        lower, upper: (N, 3) or (3,) opposite corners, metres.
        colour: (3,) or (N, 3) linear RGB.
        material: a name in `MATERIALS`.
        bottom: False leaves the bottoms out, for what stands on the ground.
    """
    both = (np.asarray(corner, np.float64).reshape(-1, 3) for corner in (lower, upper))
    low, high = np.broadcast_arrays(*both)
    corners = low[:, None] + _BOX_CORNERS * (high - low)[:, None]
    sides = BOX_FACES if bottom else BOX_FACES[1:]
    per_box = np.broadcast_to(np.asarray(colour, np.float32), (len(low), 3))
    return quads(corners[:, sides], np.repeat(per_box, len(sides), axis=0), material)


def lathe(
    profile: ArrayLike, sides: int, colour: ArrayLike, material: str, phase: float = 0.0
) -> Surface:
    """A body of revolution about z.

    Args:
        profile: (K, 2) radius and height, from the bottom up; a radius of 0 closes the end.
        sides: of each ring.
        colour: (3,) linear RGB.
        material: a name in `MATERIALS`.
        phase: radians to turn it by.
    """
    radius, height = np.asarray(profile, np.float64).T
    angle = phase + 2 * np.pi * np.arange(sides) / sides
    ring = np.stack([np.cos(angle), np.sin(angle)], axis=1)
    xy = radius[:, None, None] * ring
    z = np.broadcast_to(height[:, None, None], (len(radius), sides, 1))
    faces = []
    for k in range(len(radius) - 1):
        a = k * sides + np.arange(sides)
        b = k * sides + (np.arange(sides) + 1) % sides
        if radius[k] > 0:
            faces.append(np.stack([a, b, b + sides], axis=1))
        if radius[k + 1] > 0:
            faces.append(np.stack([a, b + sides, a + sides], axis=1))
    return Surface.make(
        np.concatenate([xy, z], axis=2).reshape(-1, 3), np.concatenate(faces), colour, material
    )


def prism(outline: ArrayLike, low: float, high: float, colour: ArrayLike, material: str) -> Surface:
    """A convex outline drawn out along z, closed at both ends, with sharp edges.

    Args:
        outline: (K, 2) metres, counter-clockwise seen from above.
        low, high: heights of the ends.
        colour: (3,) linear RGB.
        material: a name in `MATERIALS`.
    """
    points = np.asarray(outline, np.float64)
    count = len(points)
    following = np.roll(np.arange(count), -1)
    ends = [np.column_stack([points, np.full(count, z)]) for z in (low, high)]
    a = np.arange(count)
    fan = np.stack([np.zeros(count - 2, int), a[1:-1], a[2:]], axis=1)
    faces = [
        np.stack([a, following, following + count], axis=1),
        np.stack([a, following + count, a + count], axis=1),
        fan[:, ::-1],
        fan + count,
    ]
    return Surface.make(np.concatenate(ends), np.concatenate(faces), colour, material, 0.0)


def tube(
    path: ArrayLike, radii: ArrayLike, sides: int, colour: ArrayLike, material: str
) -> Surface:
    """A round bar along a path, closed at both ends.

    Args:
        path: (K, 3) centre line, metres; no direction may turn by a right angle at one point.
        radii: (K,) or one radius.
        sides: of the cross section.
        colour: (3,) linear RGB.
        material: a name in `MATERIALS`.
    """
    points = np.asarray(path, np.float64)
    count = len(points)
    radius = np.broadcast_to(np.asarray(radii, np.float64), (count,))
    along = np.gradient(points, axis=0)
    along /= np.linalg.norm(along, axis=1, keepdims=True)
    # Any fixed direction far from the path serves to keep the rings from twisting.
    mean = np.abs(along).mean(axis=0)
    side = np.cross(along, np.eye(3)[np.argmin(mean)])
    side /= np.linalg.norm(side, axis=1, keepdims=True)
    other = np.cross(along, side)
    angle = 2 * np.pi * np.arange(sides) / sides
    ring = np.cos(angle)[:, None] * side[:, None] + np.sin(angle)[:, None] * other[:, None]
    vertices = (points[:, None] + radius[:, None, None] * ring).reshape(-1, 3)
    a = (np.arange(count - 1)[:, None] * sides + np.arange(sides)).ravel()
    b = (np.arange(count - 1)[:, None] * sides + np.roll(np.arange(sides), -1)).ravel()
    fan = np.stack([np.zeros(sides - 2, int), np.arange(1, sides - 1), np.arange(2, sides)], 1)
    faces = [
        np.stack([a, b, b + sides], axis=1),
        np.stack([a, b + sides, a + sides], axis=1),
        fan[:, ::-1],
        fan + (count - 1) * sides,
    ]
    return Surface.make(vertices, np.concatenate(faces), colour, material)


def stations(length: float, spacing: float) -> Array:
    """Equal steps of at most `spacing` from 0 to length, both ends included."""
    return np.linspace(0.0, length, max(1, int(np.ceil(length / spacing - 1e-9))) + 1)


def at(surface: Surface, x: float, y: float, z: float = 0.0, heading: float = 0.0) -> Surface:
    """Turned about z by `heading` radians, then moved."""
    return surface.transformed(pose(x, y, z, heading))


def pose(x: float, y: float, z: float = 0.0, heading: float = 0.0) -> Array:
    """(4, 4) turn about z by `heading` radians, then a shift."""
    transform = np.eye(4)
    c, s = np.cos(heading), np.sin(heading)
    transform[:2, :2] = [[c, -s], [s, c]]
    transform[:3, 3] = (x, y, z)
    return transform


FACING_MINUS_X: Array = np.array([[0, 0, -1.0, 0], [-1, 0, 0, 0], [0, 1, 0, 0], [0, 0, 0, 1]])
"""(4, 4) that turns a drawing (x to the reader's right, y up, z to the reader) to face -x."""


class Panels:
    """Flat convex pieces, each with a colour and a material; flat shading.

    Facades are drawn in a frame of their own: x along the wall, the wall on y = 0, looked at from
    -y, z up.
    """

    def __init__(self) -> None:
        self._pieces: dict[str, list[tuple[Sequence[Point], ArrayLike]]] = {}

    def polygon(self, points: Sequence[Point], colour: ArrayLike, material: str) -> None:
        """A convex piece through (K, 3) points, counter-clockwise seen from where it is seen."""
        self._pieces.setdefault(material, []).append((points, colour))

    def rect(
        self,
        left: float,
        right: float,
        low: float,
        high: float,
        y: float,
        colour: ArrayLike,
        material: str,
    ) -> None:
        """An upright rectangle that looks to -y; none where it would have no area."""
        if right - left > 1e-6 and high - low > 1e-6:
            points = [(left, y, low), (right, y, low), (right, y, high), (left, y, high)]
            self.polygon(points, colour, material)

    def box(
        self, lower: Point, upper: Point, colour: ArrayLike, material: str, skip: str = ""
    ) -> None:
        """A box along the axes.

        Args:
            lower, upper: opposite corners, metres.
            colour: (3,) linear RGB.
            material: a name in `MATERIALS`.
            skip: sides that are never seen, letters of "bottom b, top t, front f, back k, left l,
                right r" (front looks to -y).
        """
        corner = [
            tuple((upper if k >> axis & 1 else lower)[axis] for axis in range(3)) for k in range(8)
        ]
        for letter, side in zip("btfklr", BOX_FACES, strict=True):
            if letter not in skip:
                self.polygon([corner[k] for k in side], colour, material)

    def surface(self) -> Surface:
        """All pieces, as fans of triangles."""
        parts = []
        for material, pieces in self._pieces.items():
            vertices = np.concatenate([np.asarray(points, np.float64) for points, _ in pieces])
            counts = [len(points) for points, _ in pieces]
            first = np.cumsum([0, *counts[:-1]])
            faces = [
                (s, s + k, s + k + 1)
                for s, n in zip(first, counts, strict=True)
                for k in range(1, n - 1)
            ]
            colours = np.repeat([colour for _, colour in pieces], np.array(counts) - 2, axis=0)
            parts.append(Surface.make(vertices, faces, colours, material, 0.0))
        return concatenate(parts)


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
        text: of the characters in `STROKES`.
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
