"""The vehicle's surface as a dense cloud of small patches, and Gaussians in their place.

Few Gaussians where nothing changes, many where colours do.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, replace

import numpy as np
import torch
from numpy.typing import NDArray
from scipy.spatial import cKDTree

from recast.actors.template.body import TemplateBody, mirror, wheel
from recast.actors.template.materials import (
    GLASS,
    GLOSS,
    PAINTED,
    PART_OF_MATERIAL,
    RIM,
    SRGB,
    TemplateMaterial,
    label_body,
)
from recast.arrays import Array, Int64Array
from recast.geometry import se3
from recast.geometry.colour import gamma_to_linear
from recast.splats.gaussians import Gaussians

Distance = Callable[[Array], Array]
Labeller = Callable[[Array, Array], Int64Array]

MIRROR = np.array([1.0, -1.0, 1.0])
"""Factors that take a side of the vehicle to the other."""

_THICKNESS = 0.002
_SPILL = 0.6  # of a cell: on sheets of one car, 0.35 left half of the spill, none more than 0.6
_CURVED = 0.006  # metres by which a surface may leave its tangent within a cell of 8 cm
COVERAGE = (1.75, 2.1)
"""Standard deviation of a Gaussian over that of its patch, and of a group of patches."""


def gradient(distance: Distance, points: Array, value: Array, step: float = 1e-3) -> Array:
    """Forward-difference gradient (N, 3) of `distance` at points (N, 3) of known `value` (N,)."""
    return np.stack(
        [(distance(points + step * axis) - value) / step for axis in np.eye(3)], axis=-1
    )


def project(distance: Distance, points: Array, steps: int) -> Array:
    """Move points (N, 3) to the zero level by Newton steps of at most 5 cm."""
    for _ in range(steps):
        value = distance(points)
        slope = gradient(distance, points, value)
        move = slope * (value / np.maximum(np.sum(slope * slope, axis=1), 1e-3))[:, None]
        length = np.linalg.norm(move, axis=1, keepdims=True)
        points = points - move * np.minimum(1.0, 0.05 / np.maximum(length, 1e-12))
    return points


def voxel_ids(points: Array, spacing: float) -> NDArray[np.int64]:
    """One integer (N,) per voxel of edge `spacing` metres; equal ids share a voxel."""
    cells = np.floor(points / spacing).astype(np.int64)
    cells -= cells.min(axis=0)
    extent = cells.max(axis=0) + 1
    return (cells[:, 0] * extent[1] + cells[:, 1]) * extent[2] + cells[:, 2]


def sample(
    distance: Distance, low: Array, high: Array, spacing: float, rng: np.random.Generator
) -> tuple[Array, Array]:
    """Points (M, 3) about `spacing` metres apart on the zero level, with outward unit normals.

    A coarse grid of a box around the surface, `low` to `high` (3,), finds the cells the surface
    crosses; in each, the points of a fine lattice near the surface, shifted a little at random, are
    projected to it and thinned to one mean a voxel. (Points drawn at random left one voxel in
    twenty empty, through which the dark inside showed.)
    """
    cell = 0.08
    axes = [np.arange(a, b + cell, cell) + cell / 2 for a, b in zip(low, high, strict=True)]
    centres = np.stack(np.meshgrid(*axes, indexing="ij"), axis=-1).reshape(-1, 3)
    value = distance(centres)
    near = np.abs(value) < 0.9 * cell
    centres, value = centres[near], value[near]
    slopes = gradient(distance, centres, value)
    steps = int(np.ceil(cell / spacing))
    places = (np.arange(steps) + 0.5) / steps * cell - cell / 2
    lattice = np.stack(np.meshgrid(places, places, places, indexing="ij"), axis=-1).reshape(-1, 3)
    expected = np.abs(value[:, None] + slopes @ lattice.T)
    cells, offsets = np.nonzero(expected < 0.8 * spacing + _CURVED)
    seeds = centres[cells] + lattice[offsets]
    seeds += rng.uniform(-0.25, 0.25, seeds.shape) * (cell / steps)
    seeds = project(distance, seeds, steps=2)
    seeds = seeds[np.all((seeds >= low) & (seeds <= high), axis=1)]
    voxel = np.unique(voxel_ids(seeds, spacing), return_inverse=True)[1]
    points = project(distance, group_means(voxel, seeds)[0], steps=2)
    value = distance(points)
    points, value = points[np.abs(value) < 2e-3], value[np.abs(value) < 2e-3]
    normals = gradient(distance, points, value)
    normals /= np.linalg.norm(normals, axis=1, keepdims=True)
    return points, normals


@dataclass(frozen=True)
class SurfaceCloud:
    """N surface patches; x forward, y left, z up from the ground, metres."""

    # points, normals: (N, 3).
    points: Array
    normals: Array
    spacing: Array  # (N,) edge of the patch
    albedo: Array  # (N, 3) linear reflectance of what is not body paint, weighted by 1 - `paint`
    gloss: Array  # (N,) see `lighting.shade`
    # paint, glass, rim: (N,) share of body paint, of window, of the metal of wheels.
    paint: Array
    glass: Array
    rim: Array
    part: Int64Array  # (N,) `VehiclePart`
    twin: Int64Array  # (N,) index of the patch mirrored at the xz plane
    # (N,) whether the patch belongs to the body, not to a wheel or mirror.
    on_body: NDArray[np.bool_]

    def painted(self, paint: Array) -> Array:
        """Albedo (N, 3) with the body paint, a linear reflectance (3,), filled in."""
        return self.albedo + self.paint[:, None] * paint

    def dyed(self, panes: tuple[float, float], rims: float) -> SurfaceCloud:
        """The cloud with factors on the diffuse and the mirrored light of windows, and on rims."""
        inside, sky = panes
        factor = 1 - self.glass * (1 - inside) - self.rim * (1 - rims)
        gloss = self.gloss * (1 - self.glass * (1 - sky))
        return replace(self, albedo=self.albedo * factor[:, None], gloss=gloss)


def tangents(normals: Array) -> tuple[Array, Array]:
    """Two unit vectors (N, 3) that span each surface patch with its normal (right-handed)."""
    helper = np.where(np.abs(normals[:, 2:]) < 0.9, [[0.0, 0.0, 1.0]], [[1.0, 0.0, 0.0]])
    first = np.cross(helper, normals)
    first /= np.linalg.norm(first, axis=1, keepdims=True)
    return first, np.cross(normals, first)


def build_cloud(body: TemplateBody, spacing: float, rng: np.random.Generator) -> SurfaceCloud:
    """Cover body, wheels and mirrors with patches of edge `spacing`, finer where colours meet.

    The left half is sampled and mirrored, so that every patch has a twin; colours are decided for
    both halves, since number plates are not symmetric.
    """
    low = np.array([-body.length / 2 - 0.01, 0.0, 0.0])
    high = np.array([body.length / 2 + 0.01, body.width / 2 + 0.01, body.height + 0.02])
    points, normals = sample(body.distance, low, high, spacing, rng)
    left = _refined(points, normals, spacing, lambda p, n: label_body(body, p, n))
    other = left[0] * MIRROR, left[1] * MIRROR, left[2]
    right = (*other, *_appearance(*other, lambda p, n: label_body(body, p, n)))
    lefts, rights = [left], [right]
    fittings = [wheel(body, axle, spacing) for axle in body.axles]
    for points, normals, labels in (*fittings, mirror(body, spacing)):
        rest = (np.full(len(points), spacing), *_look(labels))
        lefts.append((points, normals, *rest))
        rights.append((points * MIRROR, normals * MIRROR, *rest))
    joined = [np.concatenate(parts) for parts in zip(*lefts, *rights, strict=True)]
    count = len(joined[0]) // 2
    twin, on_body = np.roll(np.arange(2 * count), count), np.arange(count) < len(left[0])
    return SurfaceCloud(*[*joined, twin, np.tile(on_body, 2)])


def _look(labels: Int64Array) -> tuple[Array, ...]:
    """Albedo, gloss, the shares of paint, window and rim, and the part."""
    paint = PAINTED[labels]
    albedo: Array = gamma_to_linear(SRGB)[labels] * (1 - paint)[..., None]
    return albedo, GLOSS[labels], paint, GLASS[labels], RIM[labels], PART_OF_MATERIAL[labels]


def _children(points: Array, normals: Array, spacing: Array) -> Array:
    """Centres (4, N, 3) of the quarters of each patch."""
    first, second = tangents(normals)
    step = spacing[:, None] / 4
    return np.stack(
        [points + a * step * first + b * step * second for a in (-1, 1) for b in (-1, 1)]
    )


def _appearance(
    points: Array, normals: Array, spacing: Array, labeller: Labeller
) -> tuple[Array, ...]:
    """What `_look` gives, averaged over the quarters of each patch; the part is the first's."""
    looks = [_look(labeller(quarter, normals)) for quarter in _children(points, normals, spacing)]
    *numbers, parts = zip(*looks, strict=True)
    return *(np.mean(values, axis=0) for values in numbers), parts[0]


def _refined(
    points: Array, normals: Array, spacing: float, labeller: Labeller
) -> tuple[Array, ...]:
    """Points, normals, spacing and appearance; patches of several materials are quartered."""
    edge = np.full(len(points), spacing)
    quarters = _children(points, normals, edge)
    labels = np.stack([labeller(quarter, normals) for quarter in quarters])
    mixed = np.any(labels != labels[0], axis=0) & (labels[0] != TemplateMaterial.DARK)
    finer = quarters[:, mixed].reshape(-1, 3)
    points = np.concatenate([points[~mixed], finer])
    edge = np.concatenate([edge[~mixed], np.full(len(finer), spacing / 2)])
    normals = np.concatenate([normals[~mixed], np.tile(normals[mixed], (4, 1))])
    return (points, normals, edge, *_appearance(points, normals, edge, labeller))


def group_patches(
    points: Array,
    normals: Array,
    colours: Array,
    cells: tuple[float, ...],
    tolerance: float,
    edges: NDArray[np.bool_] | None = None,
) -> Int64Array:
    """Group (N,) of each patch: all patches of a voxel that look alike, else each one alone.

    Args:
        points, normals: (N, 3).
        colours: (N, C) display values that must agree within `tolerance` (standard deviation).
        cells: voxel edges in metres, coarsest first; what does not fit tries the next.
        edges: (N,) patches at which materials meet: a group as large as its cell would spill over
            them, so patches within 0.6 cells are not merged in it.
    """
    group = np.full(len(points), -1, np.int64)
    next_group = 0
    apart = np.full(len(points), np.inf)
    if edges is not None and edges.any():
        reach = _SPILL * max(cells)
        apart = cKDTree(points[edges]).query(points, distance_upper_bound=reach)[0]
    for cell in cells:
        open_ = np.flatnonzero((group < 0) & (apart > _SPILL * cell))
        if len(open_) == 0:
            continue
        _, ids, count = np.unique(
            _directional_voxels(points[open_], normals[open_], cell),
            return_inverse=True,
            return_counts=True,
        )
        mean_normal = _means(ids, normals[open_], count)
        mean = _means(ids, colours[open_], count)
        spread = np.sqrt(np.maximum(_means(ids, colours[open_] ** 2, count) - mean**2, 0)).max(
            axis=1
        )
        flat = np.linalg.norm(mean_normal, axis=1) > 0.985
        good = flat & (spread < tolerance)
        numbers = np.cumsum(good) - 1 + next_group
        group[open_] = np.where(good[ids], numbers[ids], -1)
        next_group += int(good.sum())
    alone = group < 0
    group[alone] = next_group + np.arange(alone.sum())
    return group


def shell_groups(points: Array, normals: Array, cell: float) -> Int64Array:
    """Group (N,) of each patch by voxel and main direction alone, whatever they look like."""
    return np.unique(_directional_voxels(points, normals, cell), return_inverse=True)[1]


def _directional_voxels(points: Array, normals: Array, cell: float) -> Int64Array:
    """Voxel number times six plus the main direction of the normal: thin sheets stay apart."""
    axis = np.argmax(np.abs(normals), axis=1)
    sign = np.take_along_axis(normals, axis[:, None], axis=1)[:, 0] > 0
    return voxel_ids(points, cell) * 6 + 2 * axis + sign


def _means(group: Int64Array, values: Array, count: Int64Array) -> Array:
    return np.stack(
        [np.bincount(group, weights=column, minlength=len(count)) / count for column in values.T],
        -1,
    )


def group_means(group: Int64Array, *arrays: Array) -> list[Array]:
    """Mean of each array (N, ...) within each group, (G, ...)."""
    count = np.bincount(group)
    results = []
    for array in arrays:
        columns = array.reshape(len(array), -1)
        results.append(_means(group, columns, count).reshape(len(count), *array.shape[1:]))
    return results


def flat_gaussians(
    group: Int64Array, points: Array, normals: Array, spacing: Array, sh: Array, opacity: float
) -> Gaussians:
    """One Gaussian a group, as wide as its patches and flat along their mean normal.

    Args:
        group: (N,) from `group_patches`.
        points, normals: (N, 3).
        spacing: (N,) edges of the patches, metres.
        sh: (G, K, 3).
    """
    centre, normal, edge = group_means(group, points, normals, spacing)
    normal = normal / np.linalg.norm(normal, axis=1, keepdims=True)
    offset = points - centre[group]
    scatter = group_means(group, offset[:, :, None] * offset[:, None, :])[0]
    scatter += (edge**2 / 12)[:, None, None] * np.eye(3)
    # leave out the normal direction before the main axes are taken
    project = np.eye(3) - normal[:, :, None] * normal[:, None, :]
    values, vectors = np.linalg.eigh(project @ scatter @ project)
    minor, major = np.sqrt(np.maximum(values[:, 1:], 1e-8)).T
    minor = np.maximum(minor, 0.35 * major)
    rotation = np.stack([vectors[:, :, 2], np.cross(normal, vectors[:, :, 2]), normal], axis=-1)
    cover = np.where(np.bincount(group) > 1, COVERAGE[1], COVERAGE[0])
    deviations = np.stack([major * cover, minor * cover, np.full_like(major, _THICKNESS)], -1)

    logits = np.full(len(centre), np.log(opacity / (1 - opacity)))
    parts = centre, se3.matrix_to_quat(rotation), np.log(deviations), logits, sh
    return Gaussians(*(torch.as_tensor(part, dtype=torch.float32) for part in parts))


def ramp(x: Array, low: float | Array, high: float | Array) -> Array:
    """From 0 at `low` to 1 at `high`, smoothly."""
    t = np.clip((x - low) / (high - low), 0.0, 1.0)
    return t * t * (3 - 2 * t)
