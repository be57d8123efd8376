"""Boxes, panels, prisms and lathed bodies, put together within checked sizes.

Colours are linear RGB (3,); a material is a name in `MATERIALS`.
"""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from numpy.typing import ArrayLike

from recast.arrays import Array
from recast.core.errors import InputError
from recast.geometry import se3
from recast.synthetic.surface import Surface, barrel, concatenate, sheet

BOX_FACES = np.array(
    [[0, 2, 3, 1], [4, 5, 7, 6], [0, 1, 5, 4], [2, 6, 7, 3], [0, 4, 6, 2], [1, 3, 7, 5]]
)
"""Quads over the corners numbered x + 2 y + 4 z: bottom, top, -y, +y, -x, +x."""
_BOX_CORNERS = np.array([[k & 1, k >> 1 & 1, k >> 2] for k in range(8)], np.float64)
Point = Sequence[float]


_PALETTES = """
glass: .02 .025 .03, .035 .04 .042, .014 .016 .02, .05 .05 .045;
blinds: .48 .46 .4, .4 .36 .3, .52 .52 .5, .3 .24 .2;
bricks: .31 .12 .075, .4 .2 .12, .24 .115 .085, .48 .37 .25, .36 .155 .09;
plasters: .6 .55 .45, .56 .46 .3, .64 .62 .58, .5 .34 .26, .42 .46 .43, .58 .42 .33, .38 .43 .49,
    .66 .6 .44, .46 .44 .42;
boards: .62 .62 .6, .3 .37 .44, .58 .51 .33, .33 .38 .31;
frames: .68 .68 .66, .68 .68 .66, .05 .05 .055, .16 .09 .05, .1 .14 .13;
doors: .2 .02 .02, .02 .06 .12, .03 .09 .05, .1 .055 .03, .02 .02 .022, .4 .27 .05;
shed_claddings: .42 .44 .45, .52 .52 .5, .18 .24 .3, .26 .32 .27, .5 .46 .37, .13 .14 .15;
accents: .03 .1 .3, .35 .03 .025, .04 .18 .09, .5 .22 .02, .06 .065 .07;
door_paints: .45 .46 .47, .05 .12 .28, .3 .06 .04, .5 .48 .42;
office_claddings: .48 .47 .44, .36 .36 .36, .58 .57 .54, .2 .21 .22, .42 .34 .26, .3 .16 .11;
tints: .02 .035 .05, .03 .05 .05, .025 .03 .03, .04 .06 .085;
tiles: .23 .085 .05, .19 .085 .06, .075 .08 .09, .12 .1 .09, .24 .11 .07, .1 .11 .12,
    .15 .125 .11;
shop_paints: .03 .07 .05, .04 .06 .14, .16 .025 .03, .02 .02 .022, .45 .42 .35, .3 .17 .03,
    .06 .2 .22, .24 .08 .16;
steel_paints: .3 .06 .03, .03 .09 .26, .04 .16 .09, .42 .16 .02, .45 .45 .43, .2 .05 .04,
    .05 .22 .28, .16 .17 .18;
posters: .02 .1 .38, .7 .7 .66, .75 .4 .02, .6 .05 .03, .72 .7 .62, .04 .04 .05, .7 .55 .08,
    .05 .05 .06, .5 .05 .04, .68 .68 .66, .03 .16 .1, .3 .55 .12, .05 .3 .36, .72 .7 .6,
    .7 .22 .1, .08 .03 .14, .7 .6 .66, .65 .1 .3;
greens: .125 .205 .04, .09 .175 .045, .165 .215 .042, .105 .16 .055, .17 .185 .035, .08 .15 .038;
needles: .042 .09 .032, .058 .096 .058, .066 .098 .03;
barks: .11 .085 .06, .15 .13 .11, .09 .07 .055;
blossoms: .62 .6 .52, .55 .16 .26, .6 .42 .05, .32 .2 .5;
trims: .52 .5 .45, .6 .58 .54;
mullions: .05 .052 .055, .42 .43 .44;
"""
PALETTES: dict[str, Array] = {
    name.strip(): np.array(values.replace(",", " ").split(), np.float64).reshape(-1, 3)
    for name, values in (entry.split(":") for entry in _PALETTES.strip(" ;\n").split(";"))
}
"""Linear RGB (N, 3). Glass: rooms behind windows by day. Greens: leaves, with the light that shines
through them. Posters have three each: ground, lettering, picture."""


def choose(rng: np.random.Generator, palette: str) -> Array:
    """One colour of `PALETTES`."""
    return PALETTES[palette][rng.integers(len(PALETTES[palette]))]


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
        bottom: False leaves the bottoms out, for what stands on the ground.
    """
    both = (np.asarray(corner, np.float64).reshape(-1, 3) for corner in (lower, upper))
    low, high = np.broadcast_arrays(*both)
    corners = low[:, None] + _BOX_CORNERS * (high - low)[:, None]
    sides = BOX_FACES if bottom else BOX_FACES[1:]
    per_box = np.broadcast_to(np.asarray(colour, np.float32), (len(low), 3))
    return quads(corners[:, sides], np.repeat(per_box, len(sides), axis=0), material)


def lathe(profile: ArrayLike, sides: int, colour: ArrayLike, material: str) -> Surface:
    """A body of revolution about z.

    Args:
        profile: (K, 2) radius and height, from the bottom up; a radius of 0 closes the end.
        sides: number of sides of each ring.
    """
    radius, height = np.asarray(profile, np.float64).T
    angle = 2 * np.pi * np.arange(sides) / sides
    ring = np.stack([np.cos(angle), np.sin(angle)], axis=1)
    xy = radius[:, None, None] * ring
    z = np.broadcast_to(height[:, None, None], (len(radius), sides, 1))
    index = np.arange(radius.size * sides).reshape(-1, sides)
    lower, upper = sheet(index, closed=True).reshape(2, -1, sides, 3)
    faces = np.concatenate([lower[radius[:-1] > 0], upper[radius[1:] > 0]])
    return Surface.make(np.concatenate([xy, z], axis=2), faces, colour, material)


def prism(outline: ArrayLike, low: float, high: float, colour: ArrayLike, material: str) -> Surface:
    """A convex outline drawn out along z, closed at both ends, with sharp edges.

    Args:
        outline: (K, 2) metres, counter-clockwise seen from above.
        low, high: heights of the ends.
    """
    points = np.asarray(outline, np.float64)
    ends = np.stack([np.column_stack([points, np.full(len(points), z)]) for z in (low, high)])
    return Surface.make(*barrel(ends), colour, material, 0.0)


def tube(
    path: ArrayLike, radii: ArrayLike, sides: int, colour: ArrayLike, material: str
) -> Surface:
    """A round bar along a path, closed at both ends.

    Args:
        path: (K, 3) centre line, metres; no direction may turn by a right angle at one point.
        radii: (K,) or one radius.
        sides: number of sides of the cross section.
    """
    points = np.asarray(path, np.float64)
    radius = np.broadcast_to(np.asarray(radii, np.float64), (len(points),))
    along = np.gradient(points, axis=0)
    along /= np.linalg.norm(along, axis=1, keepdims=True)
    # Any fixed direction far from the path serves to keep the rings from twisting.
    mean = np.abs(along).mean(axis=0)
    side = np.cross(along, np.eye(3)[np.argmin(mean)])
    side /= np.linalg.norm(side, axis=1, keepdims=True)
    other = np.cross(along, side)
    angle = 2 * np.pi * np.arange(sides) / sides
    ring = np.cos(angle)[:, None] * side[:, None] + np.sin(angle)[:, None] * other[:, None]
    return Surface.make(*barrel(points[:, None] + radius[:, None, None] * ring), colour, material)


def stations(length: float, spacing: float) -> Array:
    """Equal steps of at most `spacing` from 0 to length, both ends included."""
    return np.linspace(0.0, length, max(1, int(np.ceil(length / spacing - 1e-9))) + 1)


def at(surface: Surface, x: float, y: float, z: float = 0.0, heading: float = 0.0) -> Surface:
    """Turned about z by `heading` radians, then moved."""
    return surface.transformed(pose(x, y, z, heading))


def pose(x: float, y: float, z: float = 0.0, heading: float = 0.0) -> Array:
    """(4, 4) turn about z by `heading` radians, then a shift."""
    return se3.from_rotation_translation(se3.rotation_z(heading), np.array([x, y, z]))


FACING_MINUS_X: Array = np.array([[0, 0, -1.0, 0], [-1, 0, 0, 0], [0, 1, 0, 0], [0, 0, 0, 1]])
"""(4, 4) that turns a drawing (x to the reader's right, y up, z to the reader) to face -x."""


class SceneryPanels:
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
        a: float,
        b: float,
        low: float,
        high: float,
        y: float,
        colour: ArrayLike,
        material: str,
    ) -> None:
        """An upright rectangle from x = a to b that looks to -y; none where it has no area."""
        if b - a > 1e-6 and high - low > 1e-6:
            self.polygon([(a, y, low), (b, y, low), (b, y, high), (a, y, high)], colour, material)

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
