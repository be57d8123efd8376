"""A closed skin of triangles that is painted and dented along exact curves, and its finishes."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from functools import reduce
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from recast.arrays import Array
from recast.synthetic.surface import CREASE_ANGLE, MATERIAL_INDEX, Surface, corner_normals


class Finish(NamedTuple):
    """What a patch of skin is made of: linear RGB and a name in `MATERIALS`."""

    colour: tuple[float, float, float]
    material: str


Region = Callable[["Solid"], "Array | tuple[list[Array], list[Array]]"]
"""Where something is on a solid, see `Solid.paint`."""


@dataclass
class Solid:
    """Triangles under construction."""

    points: Array  # (V, 3) metres; x forward, y left, z up
    coords: Array  # (V, 3) coordinates of the undeformed shape, carried along by every cut
    faces: NDArray[np.int64]  # (F, 3) counter-clockwise from outside
    normals: Array  # (F, 3, 3) shading normals at the corners
    colours: Array  # (F, 3) linear RGB
    materials: NDArray[np.uint8]  # (F,) indices of `MATERIALS`

    x = property(lambda self: self.points[:, 0])
    y = property(lambda self: self.points[:, 1])
    z = property(lambda self: self.points[:, 2])
    station = property(lambda self: self.coords[:, 0])
    across = property(lambda self: self.coords[:, 1])
    up = property(lambda self: self.coords[:, 2])

    @classmethod
    def of(
        cls,
        points: Array,
        faces: NDArray[np.int64],
        finish: Finish,
        coords: Array | None = None,
        crease: float = CREASE_ANGLE,
    ) -> Solid:
        """One finish all over, shaded smoothly over edges that bend less than `crease`."""
        normals = corner_normals(points, faces.astype(np.int32), crease).astype(np.float64)
        colours = np.tile(np.asarray(finish.colour, np.float64), (len(faces), 1))
        materials = np.full(len(faces), MATERIAL_INDEX[finish.material], np.uint8)
        return cls(points, points if coords is None else coords, faces, normals, colours, materials)

    def cut(self, field: Array, limits: Sequence[Array] = ()) -> Array:
        """Split faces along the zero line of `field` (V,), where no limit exceeds `MARGIN`.

        Returns the field with zeros for the new points.
        """
        field = np.where(np.abs(field) < 1e-6, 1e-6, field)
        above = field > 0
        count = above[self.faces].sum(axis=1)
        crossed = np.flatnonzero((count == 1) | (count == 2))
        if len(limits) and len(crossed):
            near = np.maximum.reduce(limits)[self.faces[crossed]].min(axis=1) < MARGIN
            crossed = crossed[near]
        if not len(crossed):
            return field
        # A face beyond the limits is split as well where it shares a split edge.
        every = np.flatnonzero((count == 1) | (count == 2))
        stride = len(self.points)
        sides = np.sort(self.faces[every][:, [[0, 1], [1, 2], [2, 0]]], axis=2)
        keys = sides[..., 0] * stride + sides[..., 1]
        changes = above[sides[..., 0]] != above[sides[..., 1]]
        wanted = changes & np.isin(every, crossed, assume_unique=True)[:, None]
        chosen = np.unique(keys[wanted])
        place = np.searchsorted(chosen, keys).clip(0, len(chosen) - 1)
        split = changes & (chosen[place] == keys)
        first, last = np.divmod(chosen, stride)
        share = (field[first] / (field[first] - field[last]))[:, None]
        for name in ("points", "coords"):
            value = getattr(self, name)
            new = value[first] * (1 - share) + value[last] * share
            setattr(self, name, np.concatenate([value, new]))
        self._split(field, every, split, stride + place)
        return np.concatenate([field, np.zeros(len(chosen))])

    def _split(
        self,
        field: Array,
        which: NDArray[np.int64],
        split: NDArray[np.bool_],
        middle: NDArray[np.int64],
    ) -> None:
        """Replace the faces `which` (N,) whose sides are split (N, 3) at points `middle` (N, 3)."""
        number = split.sum(axis=1)
        kept = np.ones(len(self.faces), bool)
        kept[which[number > 0]] = False
        parts = [(self.faces[kept], self.normals[kept], np.flatnonzero(kept))]
        for sides in (1, 2):
            chosen = number == sides
            rows, cut, mids = which[chosen], split[chosen], middle[chosen]
            # Turn: the split sides come first and, with two of them, last.
            start = np.argmax(cut if sides == 1 else ~cut, axis=1)
            turn = (start[:, None] + np.arange(3) + (0 if sides == 1 else 2)) % 3
            a, b, c = np.take_along_axis(self.faces[rows], turn, axis=1).T
            normals = np.take_along_axis(self.normals[rows], turn[:, :, None], axis=1)
            na, nb, nc = normals[:, 0], normals[:, 1], normals[:, 2]
            mids = np.take_along_axis(mids, turn, axis=1)
            p, q = mids[:, 0], mids[:, 2]
            np_ = _mix(na, nb, field[a], field[b])
            if sides == 1:
                pieces = [((a, p, c), (na, np_, nc)), ((p, b, c), (np_, nb, nc))]
            else:
                nq = _mix(na, nc, field[a], field[c])
                pieces = [
                    ((a, p, q), (na, np_, nq)),
                    ((p, b, c), (np_, nb, nc)),
                    ((p, c, q), (np_, nc, nq)),
                ]
            parts += [(np.stack(f, 1), np.stack(n, 1), rows) for f, n in pieces]
        self.faces = np.concatenate([part[0] for part in parts])
        self.normals = np.concatenate([part[1] for part in parts])
        rows = np.concatenate([part[2] for part in parts])
        self.colours, self.materials = self.colours[rows], self.materials[rows]

    def paint(
        self,
        region: Region,
        finish: Finish,
        over: Sequence[str] = (),
    ) -> None:
        """Give the faces where `region` is negative a finish.

        Args:
            region: gives a field (V,) in metres, or borders and limits, which mean where all fields
                are negative. Every border is cut exactly, so that even strips thinner than a face
                come out whole; limits are not cut.
            over: materials that may be painted over; none means all.
        """
        inside = self._inside(region)
        if over:
            inside &= np.isin(self.materials, [MATERIAL_INDEX[name] for name in over])
        self.paint_faces(inside, finish)

    def paint_faces(self, chosen: NDArray[np.bool_], finish: Finish) -> None:
        """Give faces (F,) a finish."""
        self.colours[chosen] = finish.colour
        self.materials[chosen] = MATERIAL_INDEX[finish.material]

    def push(
        self,
        region: Region,
        move: Callable[[Array], Array],
        finish: Finish,
    ) -> None:
        """Displace the faces where `region` is negative and close the step with walls.

        Args:
            region: region of the faces, as in `paint`.
            move: new places of points (N, 3).
            finish: finish of the displaced faces and the walls.
        """
        inside = self._inside(region)
        moved = self.faces[inside]
        used, local = np.unique(moved, return_inverse=True)
        local = local.reshape(-1, 3) + len(self.points)
        edges = moved[:, [0, 1, 1, 2, 2, 0]].reshape(-1, 2)
        copies = local[:, [0, 1, 1, 2, 2, 0]].reshape(-1, 2)
        outside = self.faces[~inside][:, [1, 0, 2, 1, 0, 2]].reshape(-1, 2)
        big = len(self.points)
        rim = np.isin(edges[:, 0] * big + edges[:, 1], outside[:, 0] * big + outside[:, 1])
        (a, b), (c, d) = edges[rim].T, copies[rim].T
        walls = np.concatenate([np.stack([a, b, d], 1), np.stack([a, d, c], 1)])
        self.points = np.concatenate([self.points, move(self.points[used])])
        self.coords = np.concatenate([self.coords, self.coords[used]])
        new = Solid.of(self.points, np.concatenate([local, walls]), finish)
        self.faces = np.concatenate([self.faces[~inside], new.faces])
        self.normals = np.concatenate([self.normals[~inside], new.normals])
        self.colours = np.concatenate([self.colours[~inside], new.colours])
        self.materials = np.concatenate([self.materials[~inside], new.materials])

    def mirrored(self) -> Solid:
        """Both halves of a half at y >= 0 that is open at y = 0, welded there."""
        count = len(self.points)
        seam = np.abs(self.points[:, 1]) < 1e-9
        index = np.where(seam, np.arange(count), count + np.cumsum(~seam) - 1)
        flip = np.array([1.0, -1.0, 1.0])
        return Solid(
            np.concatenate([self.points, self.points[~seam] * flip]),
            np.concatenate([self.coords, self.coords[~seam] * flip]),
            np.concatenate([self.faces, index[self.faces][:, [0, 2, 1]]]),
            np.concatenate([self.normals, self.normals[:, [0, 2, 1]] * flip]),
            np.concatenate([self.colours, self.colours]),
            np.concatenate([self.materials, self.materials]),
        )

    def reach(self, y: float, z: float, sign: float) -> float:
        """x of the skin at (y, z), seen from the front (sign 1) or from behind (-1)."""
        a, b, c = (self.points[self.faces[:, k]] for k in range(3))
        low = np.minimum(np.minimum(a, b), c)[:, 1:] <= (y, z)
        high = np.maximum(np.maximum(a, b), c)[:, 1:] >= (y, z)
        near = np.flatnonzero(low.all(axis=1) & high.all(axis=1))
        a, b, c = a[near], b[near], c[near]
        ab, ac = b - a, c - a
        det = ab[:, 1] * ac[:, 2] - ab[:, 2] * ac[:, 1]
        det = np.where(np.abs(det) < 1e-12, np.inf, det)
        u = ((y - a[:, 1]) * ac[:, 2] - (z - a[:, 2]) * ac[:, 1]) / det
        v = ((z - a[:, 2]) * ab[:, 1] - (y - a[:, 1]) * ab[:, 2]) / det
        inside = (u >= -1e-9) & (v >= -1e-9) & (u + v <= 1 + 1e-9) & np.isfinite(det)
        if not inside.any():
            return float((sign * self.points[:, 0]).max() * sign)
        return float(sign * (sign * (a[:, 0] + u * ab[:, 0] + v * ac[:, 0]))[inside].max())

    def surface(self) -> Surface:
        """The finished part."""
        length = np.linalg.norm(self.normals, axis=2, keepdims=True)
        # Triangles without area have no normal of their own.
        normals = np.where(length > 1e-12, self.normals, [0.0, 0.0, 1.0])
        length = np.where(length > 1e-12, length, 1.0)
        return Surface(
            self.points,
            self.faces.astype(np.int32),
            (normals / length).astype(np.float32),
            self.colours.astype(np.float32),
            self.materials,
        )

    def _inside(self, region: Region) -> NDArray[np.bool_]:
        area = region(self)
        if isinstance(area, np.ndarray):
            # Every face keeps a corner off the border, which decides.
            return np.asarray(self.cut(area)[self.faces].sum(axis=1) < 0)
        for k in range(len(area[0])):
            borders, limits = region(self)
            others = [field for i, field in enumerate(borders) if i != k]
            self.cut(borders[k], [*others, *limits])
        borders, limits = region(self)
        means = [field[self.faces].mean(axis=1) for field in (*borders, *limits)]
        return np.asarray(np.maximum.reduce(means) < 0)


MARGIN = 0.06
"""Metres: borders are cut this far past each other, half a face."""


def _mix(a: Array, b: Array, field_a: Array, field_b: Array) -> Array:
    """Between a and b, where a field that changes sign between them is zero."""
    share = (field_a / (field_a - field_b))[:, None]
    return np.asarray(a * (1 - share) + b * share)


GLASS = Finish((0.018, 0.022, 0.022), "glass")
DARK_GLASS = Finish((0.008, 0.009, 0.01), "glass")
TRIM = Finish((0.018, 0.018, 0.019), "plastic")
CLADDING = Finish((0.045, 0.045, 0.047), "plastic")
UNDERSIDE = Finish((0.015, 0.015, 0.015), "matte")
SEAM = Finish((0.01, 0.01, 0.01), "matte")
CHROME = Finish((0.75, 0.76, 0.78), "chrome")
TYRE = Finish((0.02, 0.02, 0.021), "rubber")
ALLOY = Finish((0.45, 0.46, 0.47), "metal")
STEEL = Finish((0.12, 0.12, 0.125), "metal")
BEZEL = Finish((0.02, 0.02, 0.022), "plastic")
LAMP = Finish((0.3, 0.31, 0.33), "headlamp")
PROJECTOR = Finish((0.9, 0.92, 0.95), "chrome")
DAYLIGHT = Finish((0.85, 0.87, 0.9), "headlamp")
INDICATOR = Finish((0.75, 0.25, 0.02), "taillamp")
TAIL = Finish((0.42, 0.008, 0.01), "taillamp")
REVERSE = Finish((0.6, 0.58, 0.58), "taillamp")
PLATE = Finish((0.72, 0.72, 0.7), "plate")
REAR_PLATE = Finish((0.72, 0.68, 0.5), "plate")
DISPLAY = Finish((0.9, 0.42, 0.05), "signal")
INK = Finish((0.015, 0.015, 0.02), "plate")
Area = tuple[list[Array], list[Array]]
"""Borders and limits, see `Solid.paint`."""


def smooth_max(fields: Sequence[Array], radius: float) -> Array:
    """The greatest of the fields, with corners rounded at about `radius` metres."""
    best = fields[0]
    for field in fields[1:]:
        blend = np.maximum(radius - np.abs(best - field), 0)
        best = np.maximum(best, field) + blend**2 / (4 * radius)
    return best


def strip(distance: Array, half: float) -> list[Array]:
    """Fields of what lies within `half` metres of the zero of `distance`."""
    return [distance - half, -distance - half]


def rectangle(
    u: Array, v: Array, centre: tuple[float, float], size: tuple[float, float]
) -> list[Array]:
    """Fields of an upright rectangle."""
    return [*strip(u - centre[0], size[0] / 2), *strip(v - centre[1], size[1] / 2)]


def rounded(fields: Sequence[Array], radius: float, *limits: Array) -> Array:
    """One field of what lies within all fields, its corners rounded, and within sharp limits."""
    return reduce(np.maximum, limits, smooth_max(fields, radius))
