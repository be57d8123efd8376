"""Triangles with colours, materials and shading normals: what the ray tracer draws."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import Literal

import numpy as np
from numpy.typing import ArrayLike, NDArray

from recast.arrays import Array, Float32Array
from recast.core.errors import InputError
from recast.geometry import se3

Texture = Literal[
    "none",
    "asphalt",
    "concrete",
    "grass",
    "soil",
    "foliage",
    "bark",
    "brick",
    "plaster",
    "tiles",
    "corrugated",
    "wood",
    "fabric",
]
Faces = NDArray[np.int32]

CREASE_ANGLE = np.deg2rad(35)
"""Edges that bend by more than this stay sharp in the shading."""


@dataclass(frozen=True)
class Material:
    """One material; the diffuse colour is given per face."""

    name: str  # unique name
    texture: Texture = "none"  # procedural pattern that multiplies the diffuse colour
    specular: float = 0.0  # reflectance at normal incidence, Fresnel F0 in [0, 1]
    roughness: float = 1.0  # 0 mirrors, 1 has no highlight
    metallic: bool = False  # reflections take the face's colour, and there is no diffuse part
    emission: float = 0.0  # radiance added, in units of the diffuse colour under full daylight
    # reflectivity at normal incidence in [0, 1] at 905 nm, of a mid-grey surface.
    lidar: float = 0.3
    # sends light back where it came from (plates, signs, road markings).
    retroreflective: bool = False


MATERIALS: tuple[Material, ...] = (
    Material("matte"),
    Material("asphalt", "asphalt", lidar=0.12),
    Material("concrete", "concrete", lidar=0.35),
    Material("marking", "none", lidar=0.65, retroreflective=True),
    Material("grass", "grass", lidar=0.45),
    Material("soil", "soil", lidar=0.25),
    Material("foliage", "foliage", lidar=0.45),
    Material("bark", "bark", lidar=0.25),
    Material("brick", "brick", lidar=0.3),
    Material("plaster", "plaster", lidar=0.5),
    Material("tiles", "tiles", lidar=0.25),
    Material("corrugated", "corrugated", specular=0.04, roughness=0.5, lidar=0.4),
    Material("wood", "wood", lidar=0.35),
    Material("fabric", "fabric", lidar=0.3),
    Material("window", specular=0.06, roughness=0.02, lidar=0.05),
    Material("metal", specular=0.5, roughness=0.4, metallic=True, lidar=0.45),
    Material("sign", lidar=0.9, retroreflective=True),
    Material("signal", emission=1.0, lidar=0.4),
    Material("paint", specular=0.05, roughness=0.02, lidar=0.4),
    Material("glass", specular=0.05, roughness=0.01, lidar=0.04),
    Material("rubber", lidar=0.05),
    Material("chrome", specular=0.75, roughness=0.08, metallic=True, lidar=0.6),
    Material("plastic", specular=0.04, roughness=0.35, lidar=0.12),
    Material("headlamp", specular=0.08, roughness=0.03, lidar=0.7, retroreflective=True),
    Material("taillamp", specular=0.06, roughness=0.05, lidar=0.7, retroreflective=True),
    Material("plate", specular=0.02, roughness=0.4, lidar=0.9, retroreflective=True),
)
"""All materials; `Surface.materials` holds indices into this tuple. Append, never reorder."""

MATERIAL_INDEX: dict[str, int] = {material.name: i for i, material in enumerate(MATERIALS)}


@dataclass(frozen=True)
class Surface:
    """A triangle mesh, counter-clockwise seen from outside."""

    vertices: Array  # (V, 3) float64 metres
    faces: Faces  # (F, 3) int32 indices of vertices
    normals: Float32Array  # (F, 3, 3) float32 unit shading normal at each corner of each face
    colours: Float32Array  # (F, 3) float32 linear RGB diffuse reflectance in [0, 1]
    materials: NDArray[np.uint8]  # (F,) uint8 indices into `MATERIALS`

    @classmethod
    def make(
        cls,
        vertices: ArrayLike,
        faces: ArrayLike,
        colour: ArrayLike,
        material: str,
        crease: float = CREASE_ANGLE,
    ) -> Surface:
        """A surface of one material, with smooth shading over edges that bend less than `crease`.

        Args:
            vertices: (V, 3). Corners at the same place must share a vertex to be shaded smoothly.
            faces: (F, 3).
            colour: (3,) or (F, 3) linear RGB.
            material: a name in `MATERIALS`.
            crease: radians; 0 gives flat shading.
        """
        vertices = np.asarray(vertices, np.float64).reshape(-1, 3)
        faces = np.asarray(faces, np.int32).reshape(-1, 3)
        colours = np.broadcast_to(np.asarray(colour, np.float32), (len(faces), 3)).copy()
        materials = np.full(len(faces), MATERIAL_INDEX[material], np.uint8)
        return cls(vertices, faces, corner_normals(vertices, faces, crease), colours, materials)

    def __len__(self) -> int:
        return len(self.faces)

    def transformed(self, target_from_source: Array) -> Surface:
        """Moved by a rigid transform (4, 4)."""
        rotation, translation = target_from_source[:3, :3], target_from_source[:3, 3]
        return replace(
            self,
            vertices=self.vertices @ rotation.T + translation,
            normals=(self.normals @ rotation.T.astype(np.float32)).astype(np.float32),
        )

    def scaled(self, factors: ArrayLike) -> Surface:
        """Stretched along its axes by factors (3,); negative ones mirror."""
        factors = np.asarray(factors, np.float64)
        normals = self.normals / factors
        normals /= np.linalg.norm(normals, axis=2, keepdims=True)
        corners = [0, 2, 1] if np.prod(factors) < 0 else [0, 1, 2]
        return replace(
            self,
            vertices=self.vertices * factors,
            faces=self.faces[:, corners].copy(),
            normals=normals[:, corners].astype(np.float32),
        )

    def bounds(self) -> Array:
        """(2, 3) least and greatest coordinates."""
        return np.stack([self.vertices.min(axis=0), self.vertices.max(axis=0)])

    def validate(self) -> None:
        """Raise ValueError naming the field at fault."""
        count = len(self.faces)
        if self.vertices.ndim != 2 or self.vertices.shape[1] != 3:
            raise ValueError(f"Surface.vertices: expected (V, 3), got {self.vertices.shape}")
        if not np.all(np.isfinite(self.vertices)):
            raise ValueError("Surface.vertices: not all are finite")
        if count and (self.faces.min() < 0 or self.faces.max() >= len(self.vertices)):
            raise ValueError("Surface.faces: names a vertex that does not exist")
        for name, shape in (("normals", (count, 3, 3)), ("colours", (count, 3))):
            value = getattr(self, name)
            if value.shape != shape or value.dtype != np.float32:
                raise ValueError(f"Surface.{name}: expected {shape} float32, got {value.shape}")
        if self.materials.shape != (count,) or np.any(self.materials >= len(MATERIALS)):
            raise ValueError(f"Surface.materials: expected ({count},) indices of MATERIALS")


def concatenate(surfaces: Sequence[Surface]) -> Surface:
    """All triangles of all surfaces; an empty sequence gives an empty surface."""
    parts = [surface for surface in surfaces if len(surface)]
    if not parts:
        return Surface.make([], [], np.zeros(3), "matte")
    offsets = np.cumsum([0, *(len(part.vertices) for part in parts[:-1])], dtype=np.int32)
    return Surface(
        np.concatenate([part.vertices for part in parts]),
        np.concatenate([part.faces + first for part, first in zip(parts, offsets, strict=True)]),
        *(
            np.concatenate([getattr(part, name) for part in parts])
            for name in ("normals", "colours", "materials")
        ),
    )


def sheet(index: NDArray[np.int64], *, closed: bool = False) -> NDArray[np.int64]:
    """Triangles (F, 3) between grid points numbered `index` (rows, columns), lower halves first.

    Counter-clockwise seen from where columns run to the right and rows upwards. `closed` joins the
    last column to the first.
    """
    if closed:
        index = np.concatenate([index, index[:, :1]], axis=1)
    a, b, c, d = index[:-1, :-1], index[:-1, 1:], index[1:, 1:], index[1:, :-1]
    return np.concatenate([np.stack([a, b, c], -1), np.stack([a, c, d], -1)]).reshape(-1, 3)


def barrel(rings: Array) -> tuple[Array, NDArray[np.int64]]:
    """Points and faces of a body through convex rings (K, N, 3), both ends closed by fans."""
    count, sides = rings.shape[:2]
    index = np.arange(count * sides).reshape(count, sides)
    fan = np.stack([np.zeros(sides - 2, int), np.arange(1, sides - 1), np.arange(2, sides)], 1)
    faces = [sheet(index, closed=True), fan[:, ::-1], fan + index[-1, 0]]
    return rings.reshape(-1, 3), np.concatenate(faces)


def spindle(rings: Array, tips: ArrayLike) -> tuple[Array, NDArray[np.int64]]:
    """Points and faces of a body through rings (K, N, 3) that ends in two tips (2, 3).

    The faces are those of `sheet`, then those around the first and the last tip.
    """
    index = np.arange(rings.shape[0] * rings.shape[1]).reshape(rings.shape[:2])
    first, last = (np.full_like(index[0], index.size + k) for k in (0, 1))
    low = np.stack([first, np.roll(index[0], -1), index[0]], axis=1)
    high = np.stack([last, index[-1], np.roll(index[-1], -1)], axis=1)
    points = np.concatenate([rings.reshape(-1, 3), np.asarray(tips, np.float64)])
    return points, np.concatenate([sheet(index, closed=True), low, high])


def corner_normals(vertices: Array, faces: Faces, crease: float = CREASE_ANGLE) -> Float32Array:
    """Shading normals (F, 3, 3) at the corners of faces.

    A corner's normal is the mean, weighted by area, of the faces around its vertex whose own normal
    lies within `crease` radians of the corner's face.
    """
    triangles = vertices[faces]
    cross = np.cross(triangles[:, 1] - triangles[:, 0], triangles[:, 2] - triangles[:, 0])
    area = np.linalg.norm(cross, axis=1, keepdims=True)
    flat = cross / np.maximum(area, 1e-20)
    if crease <= 0 or not len(faces):
        return np.repeat(flat[:, None], 3, axis=1).astype(np.float32)
    corner_face = np.repeat(np.arange(len(faces)), 3)
    order = np.argsort(faces.ravel(), kind="stable")
    vertex = faces.ravel()[order]
    start = np.searchsorted(vertex, np.arange(len(vertices)))
    valence = np.bincount(vertex, minlength=len(vertices))
    mean = np.zeros((len(corner_face), 3))
    own = flat[corner_face]
    # One pass for each neighbour: the k-th face around every corner's vertex.
    corner_vertex = faces.ravel()
    for k in range(int(valence.max())):
        has = valence[corner_vertex] > k
        other = corner_face[order[start[corner_vertex[has]] + k]]
        near = np.einsum("ij,ij->i", own[has], flat[other]) >= np.cos(crease)
        mean[np.flatnonzero(has)[near]] += cross[other[near]]
    length = np.linalg.norm(mean, axis=1, keepdims=True)
    smooth = np.where(length > 1e-20, mean / np.maximum(length, 1e-20), own)
    return smooth.reshape(-1, 3, 3).astype(np.float32)


# Boxes, panels, prisms and lathed bodies, put together within checked sizes.
#
# Colours are linear RGB (3,); a material is a name in `MATERIALS`.

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
