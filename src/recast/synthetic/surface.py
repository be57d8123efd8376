"""Triangles with colours, materials and shading normals: what the ray tracer draws."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import Literal

import numpy as np
from numpy.typing import ArrayLike, NDArray

from recast.arrays import Array, Float32Array

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
    """One material; the diffuse colour is given per face.

    Attributes:
        name: unique name.
        texture: procedural pattern that multiplies the diffuse colour.
        specular: reflectance at normal incidence, Fresnel F0 in [0, 1].
        roughness: 0 mirrors, 1 has no highlight.
        metallic: reflections take the face's colour, and there is no diffuse part.
        emission: radiance added, in units of the diffuse colour under full daylight.
        lidar: reflectivity at normal incidence in [0, 1] at 905 nm, of a mid-grey surface.
        retroreflective: sends light back where it came from (plates, signs, road markings).
    """

    name: str
    texture: Texture = "none"
    specular: float = 0.0
    roughness: float = 1.0
    metallic: bool = False
    emission: float = 0.0
    lidar: float = 0.3
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
    """A triangle mesh, counter-clockwise seen from outside.

    Attributes:
        vertices: (V, 3) float64 metres.
        faces: (F, 3) int32 indices of vertices.
        normals: (F, 3, 3) float32 unit shading normal at each corner of each face.
        colours: (F, 3) float32 linear RGB diffuse reflectance in [0, 1].
        materials: (F,) uint8 indices into `MATERIALS`.
    """

    vertices: Array
    faces: Faces
    normals: Float32Array
    colours: Float32Array
    materials: NDArray[np.uint8]

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
