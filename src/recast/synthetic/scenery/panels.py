"""A drawing board for facades: flat pieces are put down one by one, then made one surface."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from numpy.typing import ArrayLike

from recast.synthetic.scenery.primitives import BOX_FACES
from recast.synthetic.surface import Surface, concatenate

Point = Sequence[float]


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
