"""A closed skin of triangles, painted and dented along exact curves; and smooth bodies made of it.

Underbody and wheel wells follow the shape.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from functools import partial, reduce
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from recast.arrays import Array
from recast.geometry.boxes import smooth_max
from recast.synthetic.surface import CREASE_ANGLE, MATERIAL_INDEX, Surface, corner_normals, sheet
from recast.synthetic.vehicles.parameters import VehicleSizes


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


WAIST = 0.58
"""Share of the cross-section's rows that lie below the belt line."""


@dataclass(frozen=True)
class LoftProfile:
    """A height over a station, piecewise linear at a few millimetres."""

    stations: Array  # (N,) increasing, metres
    heights: Array  # (N,) metres

    @classmethod
    def rounded(cls, corners: Sequence[tuple[float, float, float]], steps: int = 12) -> LoftProfile:
        """Each inner corner (station, height, radius) becomes a quadratic Bezier curve.

        The curve starts `radius` metres before the corner and ends as far after it, at most half
        of the straight piece.
        """
        points = np.array([corner[:2] for corner in corners], np.float64)
        t = np.linspace(0, 1, steps)[:, None]
        pieces = [points[:1]]
        for k in range(1, len(points) - 1):
            before, after = points[k - 1] - points[k], points[k + 1] - points[k]
            ends = []
            for arm in (before, after):
                length = float(np.linalg.norm(arm))
                ends.append(points[k] + arm * min(corners[k][2] / max(length, 1e-9), 0.5))
            a, b = ends
            pieces.append((1 - t) ** 2 * a + 2 * t * (1 - t) * points[k] + t**2 * b)
        curve = np.concatenate([*pieces, points[-1:]])
        keep = np.concatenate([[True], np.diff(np.maximum.accumulate(curve[:, 0])) > 1e-6])
        return cls(curve[keep, 0], curve[keep, 1])

    def __call__(self, station: Array) -> Array:
        """Heights at stations of any shape."""
        return np.interp(station, self.stations, self.heights)

    def slope(self, station: Array) -> Array:
        """Rise per metre, over 2 cm."""
        return (self(station + 0.01) - self(station - 0.01)) / 0.02

    def spread(self, start: float, end: float, count: int, focus: float = 1.0) -> Array:
        """(count,) stations from start to end, closer together where the curve is steep.

        Args:
            start, end: metres.
            count: number of stations.
            focus: 0 spaces evenly along the station, 1 along the curve.
        """
        dense = np.linspace(start, end, 800)
        rise = np.gradient(self(dense), dense)
        path = np.concatenate([[0.0], np.cumsum(np.sqrt(1 + focus * rise[1:] ** 2))])
        return np.interp(np.linspace(0, path[-1], count), path, dense)


@dataclass(frozen=True)
class LoftedBody:
    """The shape of one body; heights above the ground, x from the middle of the body."""

    # length, width: metres.
    length: float
    width: float
    top: LoftProfile  # upper outline over the station (metres behind the front end)
    bottom: float  # height of the sill and the floor
    belt: float  # height of the belt line at x = 0
    rise: float = 0.04  # how far the floor rises towards both ends
    wedge: float = 0.0  # rise of the belt line per metre towards the rear
    tumblehome: float = 0.1  # lean above the belt line, radians
    shoulder: float = 0.0  # width of the ledge at the belt line
    crown: float = 0.04  # fall of roof and bonnet from the middle to the sides
    # wrap, wrap_rear: how far windscreen and rear window stand before their outer edges.
    wrap: float = 0.1
    wrap_rear: float = 0.1
    # bow_front, bow_rear: how far the ends' middle stands out.
    bow_front: float = 0.1
    bow_rear: float = 0.06
    # lean_front, lean_rear: how far the ends fall back from the bumper to the top.
    lean_front: float = 0.06
    lean_rear: float = 0.04
    corner: float = 0.2  # radius of the upright edges in plan
    taper: float = 0.03  # share of the half width lost at the ends
    edge: float = 0.09  # radius of the upper edges in the cross-section
    arches: tuple[tuple[float, float, float], ...] = ()  # (x, z, radius) of each wheel arch
    flare: float = 0.0  # how far the arches' lips stand out
    crease: float = 0.0  # depth of the line along the side
    bumper: float = 0.5  # height of the foremost point
    # numbers of cells along x, across half the width, up the side.
    cells: tuple[int, int, int] = (40, 5, 12)

    def outline(self, x: Array) -> Array:
        """Height of the top in the middle plane, before the crown; x may be that of `coords`."""
        return self.top(self.length / 2 - x)

    def belt_at(self, x: Array) -> Array:
        """Height of the belt line."""
        return self.belt - self.wedge * x

    def half_width(self, x: Array, z: Array) -> Array:
        """Half the width of the body at a place and a height."""
        belt = self.belt_at(x)
        widest = self.bottom + 0.55 * (belt - self.bottom)
        below = np.clip((widest - z) / (widest - self.bottom), 0, 1.2)
        above = np.clip((z - widest) / (belt - widest), 0, 1)
        over = np.maximum(z - belt, 0)
        ledge = _smooth(over / 0.05) * self.shoulder
        lean = np.tan(self.tumblehome) * np.maximum(over - 0.02, 0) * (1 + 0.12 * over)
        line = belt - 0.11
        fold = self.crease * np.clip((line - z) / 0.22, 0, 1) * _smooth((z - widest + 0.3) / 0.2)
        fold = np.where(z < line, self.crease - fold, 0.0) - self.crease
        half = self.width / 2 - 0.05 * below**2 - 0.014 * above**2 - ledge - lean + fold * 0.7
        ahead = np.clip(2 * x / self.length, -1, 1)
        return half * (1 - self.taper * np.abs(ahead) ** 4)

    def half(self, finish: Finish) -> Solid:
        """The half at y >= 0, open at y = 0; `coords` are x, y / half width and share of height."""
        grid, faces = half_box(self._grid())
        box = _round(grid, self._extents(), self._radii())
        x, across, up = box[:, 0].copy(), box[:, 1] / (self.width / 2), box[:, 2]
        bent = np.where(x > 0, self.wrap, self.wrap_rear)
        station = x + bent * across**2 * np.tanh(x / (0.2 * self.length))
        height = self.outline(station)
        end = np.clip(np.abs(2 * x / self.length), 0, 1)
        low = self.bottom + self.rise * end**6
        # The belt row follows the belt line along the cabin and dives under the bonnet.
        waist = np.minimum(self.belt_at(x), low + 0.72 * (height - low))
        z = np.where(
            up < WAIST,
            low + up / WAIST * (waist - low),
            waist + (up - WAIST) / (1 - WAIST) * (height - waist),
        )
        z -= self.crown * across**2 * _smooth((up - 0.6) / 0.4)
        y = across * self.half_width(x, z)
        for ax, az, radius in self.arches:
            lip = np.hypot(x - ax, z - az) - radius - 0.02
            y += across**4 * self.flare * np.exp(-((np.maximum(lip, 0) / 0.09) ** 2))
        coords = np.stack([station, across, up], axis=1)
        points = np.stack([x + self._ends(x, across, z), y, z], axis=1)
        # The ends' bows shift the extremes: make length and width exact.
        low_x, high_x = points[:, 0].min(), points[:, 0].max()
        points[:, 0] = (points[:, 0] - low_x) / (high_x - low_x) * self.length - self.length / 2
        points[:, 1] *= self.width / 2 / points[:, 1].max()
        solid = Solid.of(points, faces, finish, coords, crease=np.pi)
        seam = points[solid.faces][:, :, 1] < 1e-9
        solid.normals[seam, 1] = 0.0
        return solid

    def _ends(self, x: Array, across: Array, z: Array) -> Array:
        reach = min(0.9, 0.35 * self.length)
        front = _smooth((x - self.length / 2 + reach) / reach)
        rear = _smooth((-x - self.length / 2 + reach) / reach)
        over = np.maximum(z - self.bumper, 0)
        under = np.maximum(self.bumper - z, 0)
        shift = front * (-self.bow_front * across**2 - self.lean_front * over - 0.2 * under)
        return shift + rear * (self.bow_rear * across**2 + self.lean_rear * over + 0.15 * under)

    def _extents(self) -> Array:
        half = np.array([self.length / 2, self.width / 2])
        return np.array([[-half[0], -half[1], 0.0], [half[0], half[1], 1.0]])

    def _radii(self) -> Array:
        tall = max(float(self.top.heights.max()) - self.bottom, 0.3)
        return np.array(
            [
                [0.6 * self.corner, self.corner, min(0.07 / tall, 0.2)],
                [self.corner, self.corner, min(self.edge / tall, 0.2)],
            ]
        )

    def _grid(self) -> tuple[Array, Array, Array]:
        nx, ny, nz = self.cells
        high = self._extents()[1]
        r_low, r_high = self._radii()
        length = self.length
        inner = self.top.spread(r_high[0], length - r_low[0], nx + 1, focus=0.6)[::-1]
        xs = np.concatenate(
            [
                [-length / 2, -length / 2 + 0.42 * r_low[0]],
                length / 2 - inner,
                [length / 2 - 0.42 * r_high[0], length / 2],
            ]
        )
        flat = np.linspace(0, high[1] - r_high[1], ny + 1)
        turn = high[1] - r_high[1] + r_high[1] * np.tan(np.linspace(0, np.pi / 4, 4)[1:])
        ys = np.concatenate([flat, turn])
        below = np.linspace(r_low[2], WAIST, max(int(nz * 0.58), 3) + 1)
        over = np.linspace(WAIST, 1 - r_high[2], max(int(nz * 0.42), 2) + 1)[1:]
        # A pair of rows close together at the belt line keeps the shoulder crisp.
        belt = np.array([WAIST + 0.025])
        rim = 1 - r_high[2] + r_high[2] * np.tan(np.linspace(0, np.pi / 4, 4)[1:])
        zs = np.concatenate([[0.0, 0.58 * r_low[2]], below, belt, over, rim])
        return xs, ys, zs


def _smooth(t: Array) -> Array:
    t = np.clip(t, 0, 1)
    return t * t * (3 - 2 * t)


def half_box(grid: tuple[Array, Array, Array]) -> tuple[Array, NDArray[np.int64]]:
    """Points and faces of a box's skin on a grid, without the side at the first y."""
    nx, ny, nz = (len(axis) - 1 for axis in grid)
    i, j, k = np.meshgrid(*(np.arange(len(axis)) for axis in grid), indexing="ij")
    skin = (i == 0) | (i == nx) | (j == ny) | (k == 0) | (k == nz)
    index = np.full(skin.shape, -1)
    index[skin] = np.arange(int(skin.sum()))
    points = np.stack([axis[n[skin]] for axis, n in zip(grid, (i, j, k), strict=True)], axis=1)
    outer = [sheet(side.T) for side in (index[nx], index[:, :, nz])]
    inner = [sheet(side) for side in (index[0], index[:, ny], index[:, :, 0])]
    return points, np.concatenate([*outer, *inner])


def _round(points: Array, extents: Array, radii: Array) -> Array:
    """Points of a box's skin, moved onto the same box with elliptical edges."""
    low, high = extents + np.array([[1.0], [-1.0]]) * radii
    core = np.clip(points, low, high)
    radius = np.where(points > core, radii[1], radii[0])
    offset = (points - core) / radius
    norm = (np.abs(offset) ** 2.2).sum(axis=1) ** (1 / 2.2)
    return core + radius * offset / np.maximum(norm, 1e-12)[:, None] * (norm > 0)[:, None]


def underside(solid: Solid, p: VehicleSizes) -> None:
    """Dark floor, and unpainted sills where the vehicle has cladding."""
    sill = p.ground_clearance + (0.13 if p.cladding else 0.045)
    solid.paint(lambda s: s.z - sill, CLADDING if p.cladding else TRIM)
    solid.paint(lambda s: s.up - 0.025, UNDERSIDE)


def wheel_wells(solid: Solid, body: LoftedBody, p: VehicleSizes) -> None:
    """Arches with cladding, opened inwards."""
    inner = p.width / 2 - p.tyre_width - 0.13

    def circle(s: Solid, x: float, z: float, radius: float) -> Array:
        field = np.hypot(s.x - x, s.z - z) - radius
        return np.maximum(np.maximum(field, s.up - 0.8), inner - s.y)

    def inwards(points: Array) -> Array:
        moved = points.copy()
        # A little depth is kept so that no triangle collapses.
        moved[:, 1] = inner + 0.03 * (points[:, 1] - inner)
        return moved

    for x, z, radius in body.arches:
        area = partial(circle, x=x, z=z, radius=radius)
        if p.cladding:
            solid.paint(partial(_within, area, p.cladding), CLADDING)
        solid.push(area, inwards, UNDERSIDE)


def _within(region: Callable[[Solid], Array], metres: float, solid: Solid) -> Array:
    """The field of a region and what lies at most some metres around it."""
    return region(solid) - metres
