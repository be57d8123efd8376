"""The generator of meshes: points evenly over textured triangles, those seen from outside, surfels.

A lattice, as in mesh2splat (Electronic Arts, github.com/electronicarts/mesh2splat): every triangle
is projected along its dominant axis onto a grid of squares that all triangles share, and has a
point wherever it covers the middle of a square. Neighbours so never overlap nor leave a gap,
however small they are, and nothing is random.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, fields, replace
from pathlib import Path

import cv2
import numpy as np
import torch
from numpy.typing import ArrayLike, NDArray
from scipy.spatial import cKDTree
from scipy.special import spence

from recast.actors.generate import AUTO, Asset, AxisConvention, BaseGenerator, axes_of, upright
from recast.actors.icp import require_volume, seen_from_outside
from recast.actors.mesh_gltf import Array, MeshMaterial, Triangles, Wrap, files_of_glb, read_glb
from recast.actors.mesh_obj import files_of_obj, read_obj
from recast.actors.observation import Observation
from recast.actors.template.cloud import (
    COVERAGE,
    flat_gaussians,
    group_means,
    group_patches,
    shell_groups,
    tangents,
)
from recast.actors.template.lighting import Daylight, fit_harmonics, road_level, road_light
from recast.arrays import Int64Array
from recast.core.errors import InputError
from recast.geometry import se3
from recast.geometry.colour import gamma_to_linear, linear_to_gamma, srgb_to_linear
from recast.splats import MIP, Gaussians
from recast.splats.gaussians import C0, concatenate

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
    """N points of a surface."""

    points: Array  # (N, 3)
    normals: Array  # (N, 3) unit, of the side that the file calls outer
    spacing: Array  # (N,) edge of the square of surface that each stands for
    albedo: Array  # (N, 3) linear base colour
    alpha: Array  # (N,) 1 where nothing shines through
    gloss: Array  # (N,) see `MeshMaterial`
    emission: Array  # (N, 3) linear light that is emitted, whatever falls on the surface

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
    """The visible surface of a vehicle."""

    samples: Samples  # samples with normals towards where they are seen from
    # (N,) whether the sample is opaque and has the vehicle's inside behind it: no view from outside
    # shows its back, as of a mirror or a spoiler.
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


# A vehicle from a textured mesh instead of a network: read, sampled, and made flat Gaussians.
#
# Few Gaussians where nothing changes, many where colours do.

_GLTF = (read_glb, files_of_glb)
_READERS = {".glb": _GLTF, ".gltf": _GLTF, ".obj": (read_obj, files_of_obj)}
MESH_SUFFIXES = tuple(_READERS)
"""Ends of the names of files that can be read, in lower case."""
MOST_GAUSSIANS = 120_000
"""Number of Gaussians of a surface, if merging can reach it: a rollout pays for each."""
_OPACITY = 0.99
_OPACITIES = np.linspace(0.001, _OPACITY, 1000)
_TAKEN = spence(1 - _OPACITIES)  # the dilogarithm Li2 of them
_CELLS = (0.04, 0.02)  # metres: points that look alike are merged in voxels of these edges
_TOLERANCES = (0.03, 0.06, 0.12, 0.25, 0.5)  # display values
_SHELL_CELL = 0.10  # metres
_SHELL_DEPTHS = (0.04, 0.10)  # metres behind the surface: a layer of its colour, and a dark one
_MARGIN, _NEAR = 0.13, 0.065  # metres: so far beside a wide Gaussian, the surface is so near
_DARK = 0.06  # display value of a cabin without light


def read_triangles(path: Path) -> list[Triangles]:
    """The triangles of a mesh file, in its frame and unit. Raises InputError: see `read_glb` and
    `read_obj`; or a file of another kind."""
    return _readers(path)[0](path)


def files_of_mesh(path: Path) -> list[Path]:
    """The file and all that it names: material libraries, textures, buffers. Raises InputError: see
    `read_triangles`."""
    return [path, *_readers(path)[1](path)]


def _readers(path: Path) -> tuple:
    suffix = path.suffix.lower()
    if suffix not in _READERS:
        known = ", ".join(MESH_SUFFIXES)
        raise InputError(path, "format", f"{suffix!r} is unknown", f"use {known}")
    return _READERS[suffix]


class MeshGenerator(BaseGenerator):
    """Takes the triangles of a glTF or OBJ file, in the light that the observation shows.

    Base colour (texture, factor and vertex colours) in daylight as bright as the road around the
    vehicle says, and what the surface emits; unlit materials keep their colour. Glass stays a layer
    of its alpha. The surface is sampled on a lattice and merged
    into flat Gaussians, see `sample` and `surfels`.

    Args:
        path: the file.
        axes: its axis convention, as such or as text, see `axes.axes_of`; "auto" tells which axis
            points up from the shape and the observed box, see `recast.actors.generate.upright`.
        spacing: metres between the points that the surface is sampled at, once the vehicle is as
            long as the box; larger is coarser and faster.

    Raises:
        InputError: no such convention.
    """

    name = "mesh"

    def __init__(
        self, path: str | Path, axes: str | AxisConvention = AUTO, spacing: float = 0.01
    ) -> None:
        self.path, self.spacing = Path(path), spacing
        self.axes = axes_of(axes) if isinstance(axes, str) and axes != AUTO else axes

    def generate(self, observation: Observation, seed: int) -> Asset:
        """Read the file; the asset keeps its axes, in metres of the box's length.

        Raises:
            InputError: see `read_triangles`; the mesh is flat; with "auto", no orientation fits
                the box, or the shape does not tell it.
        """
        parts = read_triangles(self.path)
        unit, samples, spacing = sampled(parts, observation.size[0], self.spacing)
        details: dict[str, str | float | int] = {
            "file": self.path.name,
            "triangles": sum(map(len, parts)),
        }
        try:
            seen = outside(samples)
        except ValueError as error:
            raise InputError(self.path, "mesh", str(error), "export the mesh again") from None
        if isinstance(self.axes, AxisConvention):
            axes = self.axes
        else:
            opaque = seen.samples.alpha >= 1
            found = upright(seen.samples.points[opaque], observation.size, self.path)
            axes, details["axes"] = found.axes, f"inferred from the shape: {found.explain()}"
        turn = axes.rotation()
        standing = replace(
            seen.samples, points=seen.samples.points @ turn.T, normals=seen.samples.normals @ turn.T
        )
        level = road_level(road_light(observation))
        made = surfels(replace(seen, samples=standing), Daylight(level, level))
        extent = " x ".join(f"{side / unit:.4g}" for side in np.ptp(standing.points, axis=0))
        details |= {
            "scale": f"{extent} units, z up; {unit:.4g} m a unit makes it as long as the box",
            "spacing_m": round(spacing, 4),
            "glass_share": round(float((standing.alpha < 1).mean()), 4),
            "light": round(level, 3),
        }
        back = se3.from_rotation_translation(turn.T, np.zeros(3))
        return Asset(made.transformed(torch.from_numpy(back)), axes, self.name, seed, details, MIP)


def sampled(
    parts: Sequence[Triangles], length: ArrayLike, spacing: float
) -> tuple[float, Samples, float]:
    """Metres a unit, samples in metres, and their spacing, of a mesh as long as `length` metres.

    Its longest side along an axis counts as its length; registration finds the exact scale.
    """
    low = np.min([part.corners.min(axis=(0, 1)) for part in parts], axis=0)
    high = np.max([part.corners.max(axis=(0, 1)) for part in parts], axis=0)
    unit = float(length / max((high - low).max(), 1e-9))
    centre = (low + high) / 2
    metric = [replace(part, corners=(part.corners - centre) * unit) for part in parts]
    return unit, *sample(metric, spacing)


def surfels(vehicle: Outside, light: Daylight) -> Gaussians:
    """Flat Gaussians of samples in metres, z up, in daylight.

    Samples of a voxel that look alike become one Gaussian, as wide as they are together
    (`template.cloud.flat_gaussians`); light is baked as into a template (`template.lighting`).
    Squares of edge e side by side, each a Gaussian of deviation c e / sqrt(12), overlap
    n = 2 pi c^2 / 12 times. A Gaussian of opacity o takes n Li2(o) from the logarithm of what a
    square lets through (the integral of -log(1 - o exp(-r^2 / 2)) is 2 pi Li2(o)), so that for
    glass o solves n Li2(o) = -log(1 - alpha).
    """
    samples = vehicle.samples
    group = _groups(samples)
    floor = float(samples.points[:, 2].min())
    surface = _lit(samples, group, floor, light)
    (alpha,) = group_means(group, samples.alpha)
    alone, merged = COVERAGE
    overlap = np.pi / 6 * np.where(np.bincount(group) > 1, merged, alone) ** 2
    taken = -np.log(1 - np.minimum(alpha, _OPACITY)) / overlap
    opacity = np.where(alpha < 1, np.interp(taken, _TAKEN, _OPACITIES), _OPACITY)
    logits = torch.from_numpy(np.log(opacity / (1 - opacity))).float()
    parts = [replace(surface, logit_opacities=logits)]
    if vehicle.closed.any():
        parts += _shells(samples.select(vehicle.closed), floor, light, bool((alpha < 1).any()))
    return concatenate(parts)


def _groups(samples: Samples) -> Int64Array:
    """(N,) the Gaussian of each sample; what is less alike is merged if there are too many."""
    colours = (linear_to_gamma(samples.albedo), linear_to_gamma(samples.emission))
    look = np.c_[(*colours, 0.1 * samples.gloss, samples.alpha)]
    for tolerance in _TOLERANCES:
        group = group_patches(samples.points, samples.normals, look, _CELLS, tolerance)
        if int(group.max()) < MOST_GAUSSIANS:
            break
    return group


def _lit(samples: Samples, group: Int64Array, floor: float, light: Daylight) -> Gaussians:
    """One opaque Gaussian a group, in daylight; what it emits is added to its constant colour."""
    points, normals, albedo, gloss, emission = group_means(
        group, samples.points, samples.normals, samples.albedo, samples.gloss, samples.emission
    )
    normals = normals / np.linalg.norm(normals, axis=1, keepdims=True)
    sh = fit_harmonics(albedo, gloss, normals, points[:, 2] - floor, light)
    bright = emission.any(axis=1)
    reflected = gamma_to_linear(np.clip(C0 * sh[bright, 0] + 0.5, 0.0, None))
    sh[bright, 0] = (linear_to_gamma(reflected + emission[bright]) - 0.5) / C0
    return flat_gaussians(group, samples.points, samples.normals, samples.spacing, sh, _OPACITY)


def _shells(closed: Samples, floor: float, light: Daylight, windows: bool) -> list[Gaussians]:
    """Coarse sheets behind the surface.

    The first has its colour and closes its gaps. The second is dark: through windows, one does not
    see the paint of the far side from within. Cells near an edge or of several colours have none,
    or they would show in openings and around wheels.
    """
    group = shell_groups(closed.points, closed.normals, _SHELL_CELL)
    look = linear_to_gamma(closed.albedo + closed.emission)
    centres, normals, mean, square = group_means(
        group, closed.points, closed.normals, look, look**2
    )
    normals = normals / np.linalg.norm(normals, axis=1, keepdims=True)
    inner = (square - mean**2).max(axis=1) < _TOLERANCES[0] ** 2
    tree = cKDTree(closed.points)
    behind = centres - _SHELL_DEPTHS[0] * normals
    for way in tangents(normals):
        for sign in (-1, 1):
            beside = behind + sign * _MARGIN * way
            distance, nearest = tree.query(beside)
            above = np.sum((beside - closed.points[nearest]) * closed.normals[nearest], axis=1)
            inner &= (distance < _NEAR) & (above < 0)
    if not inner.any():
        return []
    kept = closed.select(inner[group])
    group = np.unique(group[inner[group]], return_inverse=True)[1]
    (inwards,) = group_means(group, -kept.normals)
    sheet = _lit(kept, group, floor, light)
    step = torch.from_numpy(inwards).float()
    near, far = (replace(sheet, means=sheet.means + depth * step) for depth in _SHELL_DEPTHS)
    dark = torch.zeros_like(far.sh)
    dark[:, 0] = (_DARK - 0.5) / C0
    return [near, replace(far, sh=dark)] if windows else [near]
