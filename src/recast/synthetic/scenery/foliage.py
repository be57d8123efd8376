"""Leaves: lumpy opaque cores, and a skin of small irregular sprays that breaks up the outline."""

from __future__ import annotations

from functools import cache

import numpy as np
from numpy.typing import ArrayLike, NDArray

from recast.synthetic.materials import MATERIAL_INDEX
from recast.synthetic.surface import Surface

Array = NDArray[np.float64]

GREENS = np.array(
    [
        (0.125, 0.205, 0.040),
        (0.090, 0.175, 0.045),
        (0.165, 0.215, 0.042),
        (0.105, 0.160, 0.055),
        (0.170, 0.185, 0.035),
        (0.080, 0.150, 0.038),
    ]
)
"""Linear RGB of leaves by species, with the light that shines through them."""

SPRAY_SHAPE = np.array([1.25, 0.6, 1.1, 0.6])
"""How far a spray's four corners reach: pointed at both ends."""

CORE_SHADE = 0.55
"""Leaves deep inside get this share of the outer leaves' colour: they shade each other."""


@cache
def icosphere(level: int) -> tuple[Array, NDArray[np.int32]]:
    """Unit sphere of 20 * 4^level triangles: vertices (V, 3), faces (F, 3)."""
    golden = (1 + 5**0.5) / 2
    first = [(-1, golden, 0), (1, golden, 0), (-1, -golden, 0), (1, -golden, 0)]
    vertices = np.array([np.roll(v, k) for k in (0, 1, 2) for v in first], np.float64)
    vertices /= np.linalg.norm(vertices[0])
    # The 20 faces are the triples of vertices at edge length from each other.
    near = np.linalg.norm(vertices[:, None] - vertices, axis=2) < 1.1
    np.fill_diagonal(near, False)
    faces = np.array(
        [
            (a, b, c)
            for a in range(12)
            for b in range(a + 1, 12)
            for c in range(b + 1, 12)
            if near[a, b] and near[b, c] and near[a, c]
        ]
    )
    inward = np.linalg.det(vertices[faces]) < 0
    faces[inward] = faces[inward][:, ::-1]
    for _ in range(level):
        edges = np.sort(faces[:, [[0, 1], [1, 2], [2, 0]]], axis=2).reshape(-1, 2)
        unique, index = np.unique(edges, axis=0, return_inverse=True)
        middle = vertices[unique].mean(axis=1)
        middle /= np.linalg.norm(middle, axis=1, keepdims=True)
        m = index.reshape(-1, 3) + len(vertices)
        vertices = np.concatenate([vertices, middle])
        a, b, c = faces.T
        ab, bc, ca = m.T
        quarters = [(a, ab, ca), (b, bc, ab), (c, ca, bc), (ab, bc, ca)]
        faces = np.concatenate([np.stack(quarter, axis=1) for quarter in quarters])
    return vertices, faces.astype(np.int32)


def directions(rng: np.random.Generator, count: int) -> Array:
    """(count, 3) unit vectors spread evenly over the sphere, turned and jittered at random."""
    k = np.arange(count) + 0.5
    z = 1 - 2 * k / count
    angle = np.pi * (1 + 5**0.5) * k + rng.uniform(0, 2 * np.pi)
    flat = np.sqrt(1 - z**2)
    points = np.column_stack([flat * np.cos(angle), flat * np.sin(angle), z])
    points += rng.normal(0, 0.6 / np.sqrt(count), points.shape)
    return points / np.linalg.norm(points, axis=1, keepdims=True)


def cores(
    rng: np.random.Generator, centres: Array, radii: Array, colour: ArrayLike, level: int
) -> Surface:
    """Lumpy closed bodies.

    Args:
        rng: chooses the lumps.
        centres: (N, 3) metres.
        radii: (N, 3) half axes, metres.
        colour: (3,) of outer leaves; the cores are darker.
        level: of the icosphere, see `icosphere`.
    """
    sphere, faces = icosphere(level)
    count = len(centres)
    swell = 1 + rng.normal(0, 0.11, (count, len(sphere), 1))
    vertices = centres[:, None] + sphere * swell * radii[:, None]
    all_faces = (faces + len(sphere) * np.arange(count)[:, None, None]).reshape(-1, 3)
    shade = CORE_SHADE * rng.uniform(0.75, 1.2, (len(all_faces), 1))
    return Surface.make(
        vertices.reshape(-1, 3), all_faces, np.asarray(colour) * shade, "foliage", np.pi / 2
    )


def sprays(
    rng: np.random.Generator,
    points: Array,
    outward: Array,
    size: float,
    colour: ArrayLike,
    tilt: float = 0.8,
) -> Surface:
    """Small ragged pieces of two triangles each, that overlap like leaves on twigs.

    Args:
        rng: chooses outlines, tilts and shades.
        points: (N, 3) metres, their middles.
        outward: (N, 3) unit vectors that they face, roughly; also their shading normal, so that a
            crown is shaded as one body.
        size: metres across.
        colour: (3,) or (N, 3) linear RGB.
        tilt: random tilt, as the standard deviation added to the unit vectors.
    """
    count = len(points)
    facing = outward + rng.normal(0, tilt, (count, 3))
    facing /= np.linalg.norm(facing, axis=1, keepdims=True)
    # A spray that faces inwards would be seen from behind; turn it round.
    facing *= np.where(np.einsum("ij,ij->i", facing, outward) < 0, -1.0, 1.0)[:, None]
    side = np.cross(facing, rng.normal(0, 1, (count, 3)))
    side /= np.linalg.norm(side, axis=1, keepdims=True)
    up = np.cross(facing, side)
    angle = 2 * np.pi * (np.arange(4) + rng.uniform(-0.3, 0.3, (count, 4))) / 4
    reach = 0.5 * size * rng.uniform(0.7, 1.3, (count, 4)) * SPRAY_SHAPE
    corners = (
        points[:, None]
        + (reach * np.cos(angle))[..., None] * side[:, None]
        + (reach * np.sin(angle))[..., None] * up[:, None]
    )
    first = 4 * np.arange(count, dtype=np.int32)[:, None]
    faces = np.concatenate(
        [first + np.array([0, 1, 2]), first + np.array([0, 2, 3])], axis=1
    ).reshape(-1, 3)
    normal = 0.75 * outward + 0.45 * facing
    normal /= np.linalg.norm(normal, axis=1, keepdims=True)
    shade = rng.uniform(0.72, 1.3, (count, 1)) * np.column_stack(
        [rng.uniform(0.85, 1.2, count), np.ones(count), rng.uniform(0.8, 1.1, count)]
    )
    colours = np.repeat(np.clip(np.asarray(colour) * shade, 0, 1), 2, axis=0)
    return Surface(
        corners.reshape(-1, 3),
        faces.astype(np.int32),
        np.repeat(np.repeat(normal, 2, axis=0)[:, None], 3, axis=1).astype(np.float32),
        colours.astype(np.float32),
        np.full(2 * count, MATERIAL_INDEX["foliage"], np.uint8),
    )
