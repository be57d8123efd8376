"""Points evenly over textured triangles, and which of them can be seen from outside.

A lattice, as in mesh2splat (Electronic Arts, github.com/electronicarts/mesh2splat): every triangle
is projected along its dominant axis onto a grid of squares that all triangles share, and has a
point wherever it covers the middle of a square. Neighbours so never overlap nor leave a gap,
however small they are, and nothing is random.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, fields, replace

import cv2
import numpy as np
from numpy.typing import NDArray

from recast.actors.icp import require_volume, seen_from_outside
from recast.actors.mesh.triangles import Array, MeshMaterial, Triangles, Wrap
from recast.arrays import Int64Array
from recast.geometry.colour import srgb_to_linear

MOST_POINTS = 1_500_000
MOST_ROWS = 6_000_000  # of the lattice, over all triangles: slivers have many and few points
_SOLID = 0.98  # alpha above which nothing shines through
_NOTHING = 0.02  # alpha below which nothing is seen
_LEAST_AREA = 1e-9  # of a triangle, in squares: less is rounding
_LINEAR = srgb_to_linear(np.arange(256) / 255).astype(np.float32)
_CABIN_LIGHT = 0.3  # share of the daylight that falls on what stands behind glass
_BEHIND = 0.3  # cosine to the outer normal from which on a view is one of the inner side


@dataclass(frozen=True)
class Samples:
    """N points of a surface.

    Attributes:
        points: (N, 3).
        normals: (N, 3) unit, of the side that the file calls outer.
        spacing: (N,) edge of the square of surface that each stands for.
        albedo: (N, 3) linear base colour.
        alpha: (N,) 1 where nothing shines through.
        gloss: (N,) see `MeshMaterial`.
        emission: (N, 3) linear light that is emitted, whatever falls on the surface.
    """

    points: Array
    normals: Array
    spacing: Array
    albedo: Array
    alpha: Array
    gloss: Array
    emission: Array

    def __len__(self) -> int:
        return len(self.points)

    def select(self, index: NDArray[np.bool_] | Int64Array) -> Samples:
        """The points at `index`."""
        return Samples(*(getattr(self, one.name)[index] for one in fields(self)))


def sample(parts: Sequence[Triangles], step: float) -> tuple[Samples, float]:
    """Points `step` apart, and the step taken: a longer one if there were too many points.

    Args:
        parts: parts of the mesh, at least one triangle in all.
        step: edge of the lattice's squares, in the unit of the corners.
    """
    area = height = 0.0
    for part in parts:
        across = np.sort(np.abs(_twice_areas(part)), axis=1)[:, 2]
        area += float(across.sum()) / 2
        height += float(np.ptp(part.corners, axis=1).max(axis=1).sum())
    step = max(step, float(np.sqrt(area / MOST_POINTS)), height / MOST_ROWS)
    found = [_sample_part(part, step) for part in parts]
    joined = [np.concatenate([getattr(s, one.name) for s in found]) for one in fields(Samples)]
    return Samples(*joined), step


def _twice_areas(part: Triangles) -> Array:
    """(F, 3) normals, as long as the triangle is large, twice."""
    first, second, third = np.moveaxis(part.corners, 1, 0)
    return np.cross(second - first, third - first)


def _sample_part(part: Triangles, step: float) -> Samples:
    normals = _twice_areas(part)
    large = np.flatnonzero(np.abs(normals).max(axis=1) > _LEAST_AREA * step**2)
    axis = np.argmax(np.abs(normals[large]), axis=1)
    face, weights = _lattice(part.corners[large], axis, step)
    face = large[face]
    normals = normals[face] / np.linalg.norm(normals[face], axis=1, keepdims=True)
    look = np.tile(part.material.factor, (len(face), 1))
    if part.colours is not None:
        look = look * _mixed(part.colours[face], weights)
    if part.uv is not None and part.material.texture is not None:
        wrap = part.material.wrap
        look = look * _texels(part, part.uv, part.material.texture, wrap, face, weights, step)
    albedo, alpha = np.clip(look[:, :3], 0.0, 1.0), _alpha(part.material, look[:, 3])
    emission = np.zeros_like(albedo)
    if not part.material.lit:
        albedo, emission = emission, albedo
    glow = part.glow
    if glow is not None:
        shown = np.tile(glow.factor, (len(face), 1))
        if glow.uv is not None and glow.texture is not None:
            texels = _texels(part, glow.uv, glow.texture, glow.wrap, face, weights, step)
            shown = shown * texels[:, :3]
        emission = np.clip(emission + shown, 0.0, 1.0)
    spacing = step / np.sqrt(np.abs(normals).max(axis=1))
    gloss = np.full(len(face), part.material.gloss if part.material.lit else 0.0)
    points = _mixed(part.corners[face], weights)
    found = Samples(points, normals, spacing, albedo, alpha, gloss, emission)
    return found.select(alpha > _NOTHING)


def _mixed(corners: Array, weights: Array) -> Array:
    """Values (N, 3, K) at three corners, mixed by weights (N, 3)."""
    return np.einsum("nck,nc->nk", corners, weights)


def _alpha(material: MeshMaterial, alpha: Array) -> Array:
    if material.alpha == "OPAQUE":
        return np.ones_like(alpha)
    if material.alpha == "MASK":
        return (alpha >= material.cutoff).astype(np.float64)
    return np.where(alpha > _SOLID, 1.0, np.clip(alpha, 0.0, 1.0))


def _lattice(corners: Array, axis: Int64Array, step: float) -> tuple[Int64Array, Array]:
    """Face (N,) and barycentric weights (N, 3) of the lattice's points on triangles (F, 3, 3).

    Rows of the lattice are cut with the triangles' edges; half-open intervals on both axes give
    every point to one of two neighbours. Triangles without area have none.
    """
    across = (np.stack([axis + 1, axis + 2], axis=1) % 3)[:, None, :]
    flat = np.take_along_axis(corners, np.broadcast_to(across, (len(axis), 3, 2)), axis=2) / step
    face, row = _between(flat[..., 1].min(axis=1), flat[..., 1].max(axis=1), np.arange(len(axis)))
    u, v = np.moveaxis(flat[face], 2, 0)
    height = row + 0.5
    low, high = np.full(len(face), np.inf), np.full(len(face), -np.inf)
    for a, b in ((0, 1), (1, 2), (2, 0)):
        crossed = (v[:, a] <= height) != (v[:, b] <= height)
        rise = np.where(crossed, v[:, b] - v[:, a], 1.0)
        at = u[:, a] + (height - v[:, a]) / rise * (u[:, b] - u[:, a])
        low = np.where(crossed, np.minimum(low, at), low)
        high = np.where(crossed, np.maximum(high, at), high)
    order, column = _between(low, high, np.arange(len(face)))
    face, y, x = face[order], height[order], column + 0.5
    a, b, c = np.moveaxis(flat[face], 1, 0)
    p = np.stack([x, y], axis=1)
    parts = np.stack([_twice_area(b, c, p), _twice_area(c, a, p), _twice_area(a, b, p)], axis=1)
    return face, np.clip(parts / parts.sum(axis=1, keepdims=True), 0.0, 1.0)


def _between(low: Array, high: Array, owner: Int64Array) -> tuple[Int64Array, Int64Array]:
    """Owner and integer i of every i + 0.5 in the half-open intervals [low, high)."""
    first = np.ceil(np.where(low <= high, low, 0.0) - 0.5).astype(np.int64)
    count = np.maximum(np.ceil(np.where(low <= high, high, 0.0) - 0.5).astype(np.int64) - first, 0)
    before = np.cumsum(count) - count
    order = np.repeat(np.arange(len(count)), count)
    return owner[order], first[order] + np.arange(len(order)) - before[order]


def _twice_area(a: Array, b: Array, c: Array) -> Array:
    """(N,) signed, of triangles with corners (N, 2) in a plane."""
    first, second = b - a, c - a
    return first[:, 0] * second[:, 1] - first[:, 1] * second[:, 0]


def _texels(
    part: Triangles,
    corners: Array,
    texture: NDArray[np.uint8],
    wrap: tuple[Wrap, Wrap],
    face: Int64Array,
    weights: Array,
    step: float,
) -> Array:
    """(N, 4) linear colour and alpha: texels as large as the lattice's squares, bilinear.

    Args:
        corners: (F, 3, 2) texture coordinates of the part's corners.
    """
    uv = _mixed(corners[face], weights)
    shown = np.abs(_twice_area(*np.moveaxis(corners * texture.shape[1::-1], 1, 0)))
    covered = np.linalg.norm(_twice_areas(part), axis=1)
    texels = step * np.sqrt(shown[face] / covered[face])  # along a square's edge
    level = np.clip(np.rint(np.log2(np.maximum(texels, 1.0))), 0, 15).astype(np.int64)
    found = np.zeros((len(face), 4))
    picture = np.concatenate(
        [_LINEAR[texture[..., :3]], texture[..., 3:] / np.float32(255)], axis=2
    )
    for number in range(int(level.max(initial=0)) + 1):
        here = np.flatnonzero(level == number)
        found[here] = _bilinear(picture, uv[here], wrap)
        half = (max(1, picture.shape[1] // 2), max(1, picture.shape[0] // 2))
        picture = cv2.resize(picture, half, interpolation=cv2.INTER_AREA)
    return found


def _bilinear(picture: NDArray[np.float32], uv: Array, wrap: tuple[Wrap, Wrap]) -> Array:
    """(N, 4) of a picture (H, W, 4) at texture coordinates (N, 2)."""
    height, width = picture.shape[:2]
    at = uv * [width, height] - 0.5
    low = np.floor(at).astype(np.int64)
    (x, y), (u, v) = low.T, (at - low).T[:, :, None]
    left, right = (_wrapped(column, width, wrap[0]) for column in (x, x + 1))
    upper, lower = (_wrapped(row, height, wrap[1]) for row in (y, y + 1))
    above = (1 - u) * picture[upper, left] + u * picture[upper, right]
    below = (1 - u) * picture[lower, left] + u * picture[lower, right]
    return (1 - v) * above + v * below


def _wrapped(index: Int64Array, count: int, wrap: Wrap) -> Int64Array:
    """Rows or columns of a picture that has `count` of them, for any whole numbers."""
    if wrap == "CLAMP":
        return np.clip(index, 0, count - 1)
    if wrap == "MIRROR":
        index = index % (2 * count)
        return np.minimum(index, 2 * count - 1 - index)
    return index % count


@dataclass(frozen=True)
class Outside:
    """The visible surface of a vehicle.

    Attributes:
        samples: samples with normals towards where they are seen from.
        closed: (N,) whether the sample is opaque and has the vehicle's inside behind it: no view
            from outside shows its back, as of a mirror or a spoiler.
    """

    samples: Samples
    closed: NDArray[np.bool_]


def outside(samples: Samples) -> Outside:
    """What can be seen from outside, directly or through glass.

    Files wind their triangles either way, and hold engines and the insides of doors; light must
    fall on the outer side. What only glass shows gets less of it. All normals of glass point to
    one half of space, so that the two faces of a pane become one layer.

    Raises:
        ValueError: what is opaque has no volume, see `require_volume`.
    """
    opaque = samples.alpha >= 1
    require_volume(samples.points[opaque])
    directions, seen = seen_from_outside(samples.points[opaque])
    direct = seen
    if not opaque.all():
        direct = seen_from_outside(samples.points)[1][:, opaque]
    kept = ~opaque
    kept[opaque] = seen.any(axis=0)
    towards = np.eye(3)[np.argmax(np.abs(samples.normals), axis=1)]
    towards[opaque] = -(seen.T.astype(np.float64) @ directions)
    inward = np.sum(towards * samples.normals, axis=1) < 0
    normals = np.where(inward[:, None], -samples.normals, samples.normals)
    light = np.ones(len(samples))
    light[opaque] = np.where(direct.any(axis=0), 1.0, _CABIN_LIGHT)
    closed = opaque.copy()
    from_behind = directions @ normals[opaque].T > _BEHIND
    closed[opaque] = direct.any(axis=0) & ~(direct & from_behind).any(axis=0)
    shown = replace(samples, normals=normals, albedo=samples.albedo * light[:, None])
    return Outside(shown.select(kept), closed[kept])
