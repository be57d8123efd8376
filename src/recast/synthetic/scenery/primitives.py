"""Boxes, panels, prisms and lathed bodies: what street furniture is put together from."""

from __future__ import annotations

import numpy as np
from numpy.typing import ArrayLike, NDArray

from recast.synthetic.surface import Surface

Array = NDArray[np.float64]

BOX_FACES = np.array(
    [[0, 2, 3, 1], [4, 5, 7, 6], [0, 1, 5, 4], [2, 6, 7, 3], [0, 4, 6, 2], [1, 3, 7, 5]]
)
"""Quads over the corners numbered x + 2 y + 4 z: bottom, top, -y, +y, -x, +x."""
_BOX_CORNERS = np.array([[k & 1, k >> 1 & 1, k >> 2] for k in range(8)], np.float64)


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
    low, high = np.broadcast_arrays(
        np.asarray(lower, np.float64).reshape(-1, 3), np.asarray(upper, np.float64).reshape(-1, 3)
    )
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
    faces = np.concatenate(
        [
            np.stack([a, b, b + sides], axis=1),
            np.stack([a, b + sides, a + sides], axis=1),
            fan[:, ::-1],
            fan + (count - 1) * sides,
        ]
    )
    return Surface.make(vertices, faces, colour, material)


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


FACING_MINUS_X: Array = np.array(
    [[0, 0, -1, 0], [-1, 0, 0, 0], [0, 1, 0, 0], [0, 0, 0, 1]], np.float64
)
"""(4, 4) that turns a drawing (x to the reader's right, y up, z to the reader) to face -x."""
